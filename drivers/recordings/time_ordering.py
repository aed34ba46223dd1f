"""Putting a recording's messages into the order of their stamps, whatever its clocks did.

Real recordings have stamps that run backwards, in three ways that are told apart here:

- *small disorder*: messages are written in the order of arrival, and some took longer to arrive. Within
  WINDOW they are sorted.
- *a wrong stamp*: one or a few messages far from their neighbours (zero before the clock was set, a damaged
  digit). They are skipped, because nothing says when they were measured.
- *a clock that was set*: from some message on, all stamps are elsewhere. Forwards this is a pause, and the
  stamps are kept. Backwards the stamps after it are moved on so that time goes on where it stopped: order
  and durations are right again, and nothing measured is lost; only the offset to the recorded stamps is.

Far means more than WINDOW back or PAUSE ahead. Far messages are held until CONFIRM of them agree with each
other, which makes it the clock, or until the stream goes on as before, which makes them wrong. Each case is
counted in the source's report.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Protocol

from ..messages import Message

WINDOW = 1.0
"""Seconds. Queues between a sensor and a logger hold tenths of a second; a clock that is set moves by more."""
PAUSE = 60.0
"""Seconds ahead that are taken without a second look; a longer step needs messages that agree."""
CONFIRM = 5
"""Messages in a row that agree before the clock is taken to have been set."""


class Notebook(Protocol):
    """Where oddities are counted."""

    def skip(self, line: int | None, reason: str) -> None:
        """Count a message that is left out."""

    def note(self, line: int | None, reason: str) -> None:
        """Count an oddity that costs no message."""


Numbered = tuple[int, Message]


def in_order(numbered: Iterable[Numbered], notebook: Notebook) -> Iterator[Message]:
    """The messages with stamps that never decrease; messages with equal stamps keep their order.

    Takes (line or message number, message) pairs in the recording's order; holds back one WINDOW of time.
    """
    heap: list[tuple[float, int, Message]] = []
    latest = -float("inf")
    for arrived, (line, message) in enumerate(_on_one_clock(numbered, notebook)):
        if message.stamp < latest:
            notebook.note(line, "stamp runs back by less than a second; sorted")
        latest = max(latest, message.stamp)
        heapq.heappush(heap, (message.stamp, arrived, message))
        while heap[0][0] <= latest - WINDOW:
            yield heapq.heappop(heap)[2]
    while heap:
        yield heapq.heappop(heap)[2]


def _on_one_clock(numbered: Iterable[Numbered], notebook: Notebook) -> Iterator[Numbered]:
    """The messages without those whose stamps are wrong, on a clock that never steps back by more than WINDOW."""
    latest: float | None = None  # the latest stamp that was accepted, on the output's clock
    offset = 0.0  # output's clock minus the recording's clock
    held: list[Numbered] = []  # far from what was accepted, near each other
    for line, message in numbered:
        if latest is not None and _near(message.stamp + offset, latest):
            _drop(held, notebook)
            latest = max(latest, message.stamp + offset)
            yield line, _shifted(message, offset)
            continue
        if held and not _near(message.stamp, max(m.stamp for _, m in held)):
            _drop(held, notebook)
        held.append((line, message))
        if len(held) < CONFIRM:
            continue
        if latest is not None:
            offset += _set_back(held, latest - offset, notebook)
        for held_line, held_message in held:
            latest = max(held_message.stamp + offset, latest if latest is not None else -float("inf"))
            yield held_line, _shifted(held_message, offset)
        held = []
    if latest is None:  # fewer messages than it takes to confirm anything
        yield from held
    else:
        _drop(held, notebook)


def _near(stamp: float, latest: float) -> bool:
    return latest - WINDOW <= stamp <= latest + PAUSE


def _shifted(message: Message, offset: float) -> Message:
    return replace(message, stamp=message.stamp + offset) if offset else message


def _drop(held: list[Numbered], notebook: Notebook) -> None:
    for line, _ in held:
        notebook.skip(line, "stamp far from its neighbours'")
    held.clear()


def _set_back(held: list[Numbered], latest: float, notebook: Notebook) -> float:
    """What to add to the stamps from the held messages on (seconds): zero unless they are earlier than `latest`."""
    earliest = min(message.stamp for _, message in held)
    if earliest >= latest:
        return 0.0
    notebook.note(held[0][0], "clock set back; the stamps after it are moved on")
    return latest - earliest

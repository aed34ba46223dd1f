"""Order the messages of a recording by time, and correct stamps after steps of its clock.

In real recordings stamps run backwards for three reasons, which are distinguished here:

- *Small disorder*: messages are written in the order of arrival, with different delays. They are sorted within WINDOW.
- *Wrong stamps*: one or a few messages are far from their neighbours (zero before the clock was set, a damaged digit).
  They are skipped, because the time of their measurement is unknown.
- *Clock steps*: from some message on, all stamps are offset. A step forwards is taken as a pause, and the stamps are
  kept. After a step backwards the stamps are shifted so that time continues where it stopped: order and durations are
  correct, no message is lost, but the stamps differ from the recorded ones by an offset.

Far means more than WINDOW back or MAX_PAUSE ahead. Far messages are held until CONFIRMATIONS of them agree with each
other, which is a clock step, or until the stream continues as before, which makes them wrong. Each case is counted in
the source's report.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Protocol

from ..messages import Message

WINDOW = 1.0
"""Seconds. Queues between a sensor and a logger hold tenths of a second; clock steps are larger."""
MAX_PAUSE = 60.0
"""Seconds. Steps ahead up to this are accepted at once; larger ones need CONFIRMATIONS."""
CONFIRMATIONS = 5
"""Consecutive messages that must agree before a clock step is accepted."""


class AnomalyCounter(Protocol):
    """Counter of skipped messages and anomalies; `line` is a line or message number."""

    def skip(self, line: int | None, reason: str) -> None:
        """Count an omitted message."""

    def note(self, line: int | None, reason: str) -> None:
        """Count an anomaly without loss of a message."""


Numbered = tuple[int, Message]


def order_by_time(numbered: Iterable[Numbered], anomalies: AnomalyCounter) -> Iterator[Message]:
    """Yield the messages with non-decreasing stamps; messages with equal stamps keep their order.

    Takes (line or message number, message) pairs in the recording's order; delays them by WINDOW seconds of stamps.
    """
    heap: list[tuple[float, int, Message]] = []
    latest = -float("inf")
    for arrived, (line, message) in enumerate(_correct_clock_steps(numbered, anomalies)):
        if message.stamp < latest:
            anomalies.note(line, "stamp less than a second out of order; sorted")
        latest = max(latest, message.stamp)
        heapq.heappush(heap, (message.stamp, arrived, message))
        while heap[0][0] <= latest - WINDOW:
            yield heapq.heappop(heap)[2]
    while heap:
        yield heapq.heappop(heap)[2]


def _correct_clock_steps(numbered: Iterable[Numbered], anomalies: AnomalyCounter) -> Iterator[Numbered]:
    """Yield the messages without wrong stamps, on a clock that never steps back by more than WINDOW."""
    latest: float | None = None  # the latest stamp that was accepted, on the output's clock
    offset = 0.0  # output's clock minus the recording's clock
    held: list[Numbered] = []  # far from the accepted stamps, near each other
    for line, message in numbered:
        if latest is not None and _near(message.stamp + offset, latest):
            _drop(held, anomalies)
            latest = max(latest, message.stamp + offset)
            yield line, _shifted(message, offset)
            continue
        if held and not _near(message.stamp, max(m.stamp for _, m in held)):
            _drop(held, anomalies)
        held.append((line, message))
        if len(held) < CONFIRMATIONS:
            continue
        if latest is not None:
            offset += _backward_step(held, latest - offset, anomalies)
        for held_line, held_message in held:
            latest = max(held_message.stamp + offset, latest if latest is not None else -float("inf"))
            yield held_line, _shifted(held_message, offset)
        held = []
    if latest is None:  # fewer messages than CONFIRMATIONS
        yield from held
    else:
        _drop(held, anomalies)


def _near(stamp: float, latest: float) -> bool:
    return latest - WINDOW <= stamp <= latest + MAX_PAUSE


def _shifted(message: Message, offset: float) -> Message:
    return replace(message, stamp=message.stamp + offset) if offset else message


def _drop(held: list[Numbered], anomalies: AnomalyCounter) -> None:
    for line, _ in held:
        anomalies.skip(line, "stamp far from those of its neighbours; skipped")
    held.clear()


def _backward_step(held: list[Numbered], latest: float, anomalies: AnomalyCounter) -> float:
    """Return the shift (seconds) of the stamps from the held messages on: zero unless they precede `latest`."""
    earliest = min(message.stamp for _, message in held)
    if earliest >= latest:
        return 0.0
    anomalies.note(held[0][0], "clock was set back; later stamps are shifted")
    return latest - earliest

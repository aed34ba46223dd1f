"""Order the messages of a recording by time, and correct stamps after steps of its clock.

In real recordings stamps run backwards for four reasons, which are distinguished here:

- *Small disorder*: messages are written in the order of arrival, with different delays. They are sorted within WINDOW.
- *Late messages*: over a radio link, those of one sensor may arrive half a minute after those of the others. Their
  stamps go on from the sensor's own, so they are right; they are sorted by them.
- *Wrong stamps*: one or a few messages are far from their neighbours (zero before the clock was set, a damaged digit).
  They are skipped, because the time of their measurement is unknown.
- *Clock steps*: from some message on, all stamps are offset. A step forwards is taken as a pause, and the stamps are
  kept. After a step backwards the stamps are shifted so that time continues where it stopped: order and durations are
  correct, no message is lost, but the stamps differ from the recorded ones by an offset.

Far means more than WINDOW back or MAX_PAUSE ahead, both of the latest message of all and of the sensor's own. Far
messages are held until CONFIRMATIONS of them agree with each other, which is a clock step, or until the stream
continues as before, which makes them wrong. Each case is counted in the source's report.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Protocol

from ..messages import Message, Scan

WINDOW = 1.0
"""Seconds. Queues between a sensor and a logger hold tenths of a second; clock steps are larger."""
MAX_PAUSE = 60.0
"""Seconds. Steps ahead up to this are accepted at once; larger ones need CONFIRMATIONS."""
MAX_LATENESS = 60.0
"""Seconds of stamps that the messages of a sensor may be late. The longest met is 29; more would need more memory."""
CONFIRMATIONS = 5
"""Consecutive messages that must agree before a clock step is accepted."""


FAR = "stamp far from those of its neighbours; skipped"
"""Reason to skip a message whose time is unknown."""


class AnomalyCounter(Protocol):
    """Counter of skipped and of corrected messages."""

    def skip(self, line: int | None, reason: str) -> None:
        """Count an omitted message; `line` is its line or message number."""

    def correct(self, text: str) -> None:
        """Count a correction without loss of a message."""


Numbered = tuple[int, Message]


Sensor = tuple[type, int]


@dataclass(slots=True)
class _Progress:
    """Stamps that were reached, on the output's clock.

    latest   of the messages of each sensor
    newest   of all messages; None before the first
    yielded  of the messages that were yielded
    """

    latest: dict[Sensor, float] = field(default_factory=dict)
    newest: float | None = None
    yielded: float = -float("inf")

    def accept(self, message: Message) -> None:
        sensor = _sensor(message)
        self.latest[sensor] = max(message.stamp, self.latest.get(sensor, message.stamp))
        self.newest = message.stamp if self.newest is None else max(message.stamp, self.newest)

    def continues(self, message: Message, stamp: float) -> bool:
        """Return true if a stamp goes on from the latest message of all, or from the sensor's own late ones."""
        if self.newest is None:
            return False
        own = self.latest.get(_sensor(message))
        return _near(stamp, self.newest) or (own is not None and stamp >= self.yielded and _near(stamp, own))

    def complete(self) -> float:
        """Return the stamp up to which no sensor is expected to have further messages."""
        assert self.newest is not None
        return max(min(self.latest.values()), self.newest - MAX_LATENESS) - WINDOW


def order_by_time(numbered: Iterable[Numbered], anomalies: AnomalyCounter) -> Iterator[Message]:
    """Yield the messages with non-decreasing stamps; messages with equal stamps keep their order.

    Takes (line or message number, message) pairs in the recording's order; delays them by WINDOW seconds of stamps, or
    until the last sensor has reached them, MAX_LATENESS seconds at most.
    """
    heap: list[tuple[float, int, Message]] = []
    progress = _Progress()
    for arrived, message in enumerate(_correct_clock_steps(numbered, progress, anomalies)):
        newest = message.stamp if progress.newest is None else progress.newest
        if message.stamp < newest - WINDOW:
            anomalies.correct("arrived more than a second late; sorted by its stamp")
        elif message.stamp < newest:
            anomalies.correct("stamp less than a second out of order; sorted")
        progress.accept(message)
        heapq.heappush(heap, (message.stamp, arrived, message))
        complete = progress.complete()
        while heap and heap[0][0] <= complete:
            progress.yielded, _, earliest = heapq.heappop(heap)
            yield earliest
    while heap:
        yield heapq.heappop(heap)[2]


def sort_within(messages: Iterable[Message], seconds: float) -> Iterator[Message]:
    """Yield messages whose stamps are at most so many seconds out of order with non-decreasing stamps.

    Messages with equal stamps keep their order.
    """
    heap: list[tuple[float, int, Message]] = []
    for arrived, message in enumerate(messages):
        heapq.heappush(heap, (message.stamp, arrived, message))
        while heap and heap[0][0] <= message.stamp - seconds:
            yield heapq.heappop(heap)[2]
    while heap:
        yield heapq.heappop(heap)[2]


def _correct_clock_steps(
    numbered: Iterable[Numbered], progress: _Progress, anomalies: AnomalyCounter
) -> Iterator[Message]:
    """Yield the messages without wrong stamps, on a clock that never steps back by more than WINDOW.

    The caller updates `progress` after each message.
    """
    offset = 0.0  # output's clock minus the recording's clock
    held: list[Numbered] = []  # far from the accepted stamps, near each other
    for line, message in numbered:
        if progress.continues(message, message.stamp + offset):
            _drop(held, anomalies)
            yield _shifted(message, offset)
            continue
        if held and not _near(message.stamp, max(m.stamp for _, m in held)):
            _drop(held, anomalies)
        held.append((line, message))
        if len(held) < CONFIRMATIONS:
            continue
        if progress.newest is not None:
            offset += _backward_step(held, progress.newest - offset, anomalies)
        for _, held_message in held:
            yield _shifted(held_message, offset)
        held = []
    if progress.newest is None:  # fewer messages than CONFIRMATIONS
        yield from (message for _, message in held)
    else:
        _drop(held, anomalies)


def _sensor(message: Message) -> Sensor:
    """Return what the stamps of a message go on from: others of the same type and, for scans, the same lidar."""
    return type(message), message.lidar if isinstance(message, Scan) else 0


def _near(stamp: float, latest: float) -> bool:
    return latest - WINDOW <= stamp <= latest + MAX_PAUSE


def _shifted(message: Message, offset: float) -> Message:
    return replace(message, stamp=message.stamp + offset) if offset else message


def _drop(held: list[Numbered], anomalies: AnomalyCounter) -> None:
    for line, _ in held:
        anomalies.skip(line, FAR)
    held.clear()


def _backward_step(held: list[Numbered], latest: float, anomalies: AnomalyCounter) -> float:
    """Return the shift (seconds) of the stamps from the held messages on: zero unless they precede `latest`."""
    earliest = min(message.stamp for _, message in held)
    if earliest >= latest:
        return 0.0
    anomalies.correct("clock was set back; later stamps are shifted")
    return latest - earliest

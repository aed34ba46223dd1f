"""Recognise stamps in milliseconds, microseconds or nanoseconds, and convert them to seconds.

The speed of the robot shows the unit: it drives slower by a factor of a thousand if the stamps of its odometry are in
milliseconds but read as seconds. Speeds are only compared if the stamps cannot be seconds, or a scanner would need more
than MIN_STEP seconds for a scan. A log that really has a scan every few seconds shows a robot of normal speed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice
from typing import Protocol

import numpy as np

from ..messages import Message, Odometry, Scan
from .time_ordering import Numbered

MAX_STAMP = 2.0**31
"""Seconds. Later stamps (after January 2038) do not fit into the 32 bits of a ROS stamp."""
UNITS = {1.0: "seconds", 1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
"""Units of stamps, by their number in a second, in ascending order."""
SAMPLE = 100
"""Messages that are examined before the first is passed on. Origin: chosen, some seconds of a drive."""
MIN_MESSAGES = 20
"""Messages below which the unit is not judged. Origin: chosen; a median of few steps is uncertain."""
MIN_STEP = 5.0
"""Median time between scans in seconds as read, below which they are seconds. Origin: geometry; scanners make at most
200 scans in a second, one in 5 ms."""
MAX_SPEED = 10.0
"""m/s. Origin: chosen; robots that map with a 2-D lidar are slower, and faster than a thousandth of it."""
MIN_PATH = 0.5
"""Metres that must be driven for the speed. Origin: chosen, far above the resolution of odometry."""
EARLIEST_DATE = 6e8
"""Seconds since 1970. Origin: definition; 1989, before the first recordings of 2-D lidars."""


class StampReport(Protocol):
    """Receiver of what was found out about the stamps."""

    def interpret(self, text: str) -> None:
        """Report how the stamps are read."""

    def doubt(self, text: str) -> None:
        """Report that the stamps are probably wrong."""

    def skip(self, line: int | None, reason: str) -> None:
        """Count an omitted message."""


def is_valid_stamp(stamp: float) -> bool:
    """Return true if a stamp (seconds) is finite, not negative, and less than MAX_STAMP."""
    return 0.0 <= stamp < MAX_STAMP


def in_seconds(numbered: Iterable[Numbered], report: StampReport) -> Iterator[Numbered]:
    """Yield the messages with stamps in seconds, whatever the unit of the recording; skip those without a valid stamp.

    Takes (line or message number, message) pairs with finite stamps in the recording's order. The first SAMPLE messages
    decide the unit; if that needs the robot's speed, as many more as it needs to move.
    """
    iterator = iter(numbered)
    sample: list[Numbered] = []
    per_second: float | None = None
    size = SAMPLE
    while per_second is None:
        sample += islice(iterator, size - len(sample))
        messages = [message for _, message in sample]
        per_second = find_unit(messages)
        if per_second is None and len(sample) < size:
            per_second = _unit_of_date(messages)
            report.doubt("unit of the stamps is uncertain: they are no seconds, and the robot does not move")
        size *= 2
    if per_second != 1.0:
        report.interpret(f"stamps in {UNITS[per_second]}, converted to seconds")
    for line, message in chain(sample, iterator):
        stamp = message.stamp / per_second
        if is_valid_stamp(stamp):
            yield line, message if per_second == 1.0 else replace(message, stamp=stamp)
        else:
            report.skip(line, "stamp is invalid")


def find_unit(messages: Sequence[Message]) -> float | None:
    """Return how many units of the stamps are in a second; None if the robot has to move for that."""
    if len(messages) < MIN_MESSAGES:
        return 1.0
    if _median_stamp(messages) < MAX_STAMP and not MIN_STEP <= _median_step(messages) < math.inf:
        return 1.0
    speed = _speed(messages)
    return None if speed is None else next((unit for unit in UNITS if speed * unit > MAX_SPEED / 1e3), 1.0)


def _unit_of_date(messages: Sequence[Message]) -> float:
    """Return the unit that makes the stamps dates of the past and near future; seconds if there is none."""
    stamp = _median_stamp(messages)
    return next((unit for unit in UNITS if EARLIEST_DATE <= stamp / unit < MAX_STAMP), 1.0)


def _median_stamp(messages: Sequence[Message]) -> float:
    return float(np.median([message.stamp for message in messages]))


def _median_step(messages: Sequence[Message]) -> float:
    """Return the median time between scans, or between odometry if there are no scans; infinity if there is none."""
    scans = [message.stamp for message in messages if isinstance(message, Scan)]
    steps = np.diff(scans or [message.stamp for message in messages if isinstance(message, Odometry)])
    return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else math.inf


def _speed(messages: Sequence[Message]) -> float | None:
    """Return the median speed while the odometry moves, metres per unit of the stamps; None if it hardly moves."""
    odometry = [message for message in messages if isinstance(message, Odometry)]
    if len(odometry) < 2:
        return None
    distances = np.hypot(*np.diff([message.pose[:2] for message in odometry], axis=0).T)
    elapsed = np.diff([message.stamp for message in odometry])
    moving = (distances > 0.0) & (elapsed > 0.0)
    if float(distances[moving].sum()) < MIN_PATH:
        return None
    return float(np.median(distances[moving] / elapsed[moving]))

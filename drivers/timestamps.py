"""Stamps are float64 seconds in memory and integer nanoseconds in recordings; these convert without loss.

Seconds that were made from nanoseconds, or written with at most nine decimals, survive the way there and
back bit for bit.

What happens now is timed by the host's steady clock, `time.monotonic`, and stamped with the time of day as it was
known when the program started: such stamps never jump, and those of programs on one computer can be compared as long
as nobody sets its clock.
"""

from __future__ import annotations

import math
import time

NANOSECONDS = 1_000_000_000
LOOKS = 5
"""At the clocks; a process that is put aside between two of them makes one look worthless, not all."""


def to_nanoseconds(stamp: float) -> int:
    """The nearest whole nanosecond to a stamp in seconds."""
    seconds = math.floor(stamp)
    return seconds * NANOSECONDS + round((stamp - seconds) * 1e9)  # the difference is exact, stamp * 1e9 is not


def to_seconds(nanoseconds: int) -> float:
    """The stamp in seconds, correctly rounded."""
    return nanoseconds / NANOSECONDS


def day_offset() -> float:
    """Seconds to add to the host's steady clock to have the time of day (since 1970) as it is set now."""
    looks = []
    for _ in range(LOOKS):
        before, day, after = time.monotonic(), time.time(), time.monotonic()
        looks.append((after - before, day - 0.5 * (before + after)))
    return min(looks)[1]

"""Stamps are float64 seconds in memory and integer nanoseconds in recordings; these convert without loss.

Seconds that were made from nanoseconds, or written with at most nine decimals, survive the way there and
back bit for bit.
"""

from __future__ import annotations

import math

NANOSECONDS = 1_000_000_000


def to_nanoseconds(stamp: float) -> int:
    """The nearest whole nanosecond to a stamp in seconds."""
    seconds = math.floor(stamp)
    return seconds * NANOSECONDS + round((stamp - seconds) * 1e9)  # the difference is exact, stamp * 1e9 is not


def to_seconds(nanoseconds: int) -> float:
    """The stamp in seconds, correctly rounded."""
    return nanoseconds / NANOSECONDS

"""Conversion of stamps between float64 seconds (in memory) and integer nanoseconds (in recordings), without loss.

Seconds that were converted from nanoseconds, or have at most nine decimals, survive the round trip bit for bit.

Live measurements are timed by the host's monotonic clock, `time.monotonic`, plus `wall_clock_offset` as measured when
the program started. Such stamps never jump, and those of several programs on one computer are comparable unless the
wall clock is set in between.
"""

from __future__ import annotations

import math
import time

NANOSECONDS = 1_000_000_000
MIN_EPOCH_STAMP = 1e8
"""Seconds. Larger stamps (1973) count from 1970, smaller ones from the start of the recording."""
CLOCK_READINGS = 5
"""Number of readings of both clocks; the one with the shortest interruption is used."""


def to_nanoseconds(stamp: float) -> int:
    """Return the nearest whole nanosecond to a stamp in seconds."""
    seconds = math.floor(stamp)
    return seconds * NANOSECONDS + round((stamp - seconds) * 1e9)  # the difference is exact, stamp * 1e9 is not


def to_seconds(nanoseconds: int) -> float:
    """Return the stamp in seconds, correctly rounded."""
    return nanoseconds / NANOSECONDS


def follows(stamp: float, latest: float) -> bool:
    """Return True if a stamp may be one after the latest of earlier measurements: later, and not on another clock.

    The clock is another one if it counts from 1970, and the one of the earlier measurements does not.
    """
    return stamp > latest and not -math.inf < latest < MIN_EPOCH_STAMP < stamp


def wall_clock_offset() -> float:
    """Return the offset (seconds) from the host's monotonic clock to its wall clock (since 1970) as it is set now."""
    readings = []
    for _ in range(CLOCK_READINGS):
        before, wall, after = time.monotonic(), time.time(), time.monotonic()
        readings.append((after - before, wall - 0.5 * (before + after)))
    return min(readings)[1]

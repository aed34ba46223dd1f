"""Time from one measurement of a sensor to the next, also where stamps come in bursts."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence

# Latest intervals between measurements of which the median is the sensor's period, or the mean if they come in bursts.
# Origin: chosen, longer than the bursts of a computer that is busy for some seconds; not measured.
PERIOD_SAMPLES = 101
# Seconds. Smallest period of a lidar: in a shorter time the stamps of a burst follow each other.
# Origin: definition, the fastest two-dimensional lidars measure 100 scans per second; half of their period.
MIN_PERIOD = 0.005
# Seconds between two measurements of a common lidar, which turns ten times a second; other sensors measure more often,
# and robots hardly change their acceleration meanwhile. Origin: chosen; not measured.
USUAL_PERIOD = 0.1
# Seconds between two measurements of the slowest lidars and gyroscopes. Origin: chosen; not measured.
MAX_PERIOD = 0.25
# Share of the period below which the interval between two stamps shows that they come in bursts. Not half: a log
# without some of its scans has intervals of one, two and three periods. Origin: chosen; not measured.
MIN_INTERVAL = 0.25


class MeasurementClock:
    """Seconds from one measurement of a sensor to the next: scan to scan, or reading to reading of odometry.

    The stamps of recordings may come in bursts, if a busy computer stamped the scans when it read them. The lidar
    turned evenly meanwhile, so the mean of the latest intervals is used then. If most scans are in bursts, the median
    is no period of a lidar either. The same holds for readings of odometry. A pause that is longer than the latest
    intervals together is none between bursts: measurements are missing.

    last    stamp of the last measurement; None before the first, and after `start_again`
    period  of the sensor in seconds; NaN before the second measurement
    """

    def __init__(self, last: float | None = None, intervals: Sequence[float] = ()) -> None:
        self.last, self._latest, self._ordered = last, deque(intervals), sorted(intervals)
        self.period, self._total, self._in_bursts = math.nan, 0.0, False
        if self._ordered:
            self._find_period()

    @property
    def intervals(self) -> tuple[float, ...]:
        """Latest differences of stamps."""
        return tuple(self._latest)

    def start_again(self) -> None:
        """Measure no interval to the next measurement: it may be one of those so far, or follow a break."""
        self.last = None

    def interval(self, stamp: float) -> float:
        """Return the seconds from the last measurement to one at `stamp`, which becomes the last.

        The result is 0 for the first measurement, and for the first one after `start_again`.
        """
        last, self.last = self.last, stamp
        if last is None:
            return 0.0
        is_full = len(self._latest) == PERIOD_SAMPLES
        if is_full and self._in_bursts and stamp - last > self._total:
            return stamp - last
        self._add(stamp - last)
        return self.period if self._in_bursts else max(stamp - last, self.period)

    def _add(self, interval: float) -> None:
        """Add an interval to the latest ones, which are kept in order too: to sort them each time takes longer."""
        self._latest.append(interval)
        insort(self._ordered, interval)
        if len(self._latest) > PERIOD_SAMPLES:
            del self._ordered[bisect_left(self._ordered, self._latest.popleft())]
        self._find_period()

    def _find_period(self) -> None:
        """Find the period from the latest intervals, and their sum if the measurements come in bursts."""
        ordered = self._ordered
        self.period = 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
        self._in_bursts = self.period < MIN_PERIOD or ordered[0] < MIN_INTERVAL * self.period
        if self._in_bursts:
            self._total = sum(ordered)
            self.period = self._total / len(ordered)

"""Queue of the scans that wait for odometry, in which scans of a second lidar are paired with those of the first.

Both lidars rotate on their own. A scan of the first is paired with the earliest unused scan of the second whose middle
is in a window around its own. It waits until that scan arrives, or until none is to be expected in the window any more,
so pairs do not depend on the order in which scans arrive.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from drivers.messages import Scan

from ..odometry.measurement_clock import MAX_PERIOD, USUAL_PERIOD
from .deskew import sweep_middle

# Scans that wait, and seconds between the first and the last of them, above both of which odometry is not waited for:
# until its next reading, scans are processed without it. The motion is interpolated in shorter gaps.
# Origin: chosen, a base that is reconnected answers within seconds; not measured.
MAX_QUEUED_SCANS, MAX_QUEUED_SECONDS = 20, 10.0
# Begin and end of the window, in intervals between scans of the first lidar, from the middle of its scan. With lidars
# of equal rate each window of one interval has a scan in it; a quarter more is for uneven stamps. It ends early, as a
# scan waits until then. Origin: geometry.
WINDOW = (-0.75, 0.5)
# The same without odometry: motions are predicted to the end of the first lidar's sweep only. Origin: as WINDOW.
WINDOW_WITHOUT_ODOMETRY = (-1.25, 0.0)
# Intervals whose median is used. Origin: chosen; scans that are stamped when they are sent come in bursts.
INTERVALS = 5
# Share of an interval after which the next scan is expected at the earliest. Origin: definition, as for WINDOW.
EARLIEST = -WINDOW[0]
# Seconds without a scan of the second lidar from which on it is not waited for. Origin: definition, two missing scans.
MAX_ABSENCE = 2.0 * MAX_PERIOD


class ScanPair(NamedTuple):
    """Scan of the first lidar, and the one of the second lidar that is joined with it, if any."""

    first: Scan
    second: Scan | None = None


class ScanQueue:
    """Scans of one or two lidars in time order, until odometry covers their sweep."""

    def __init__(self, *, two_lidars: bool = False, predicts_odometry: bool = False) -> None:
        """`two_lidars` if the second lidar is waited for from the beginning, and not from its first scan on.

        `predicts_odometry` if there is no odometry.
        """
        self._two_lidars, self._predicts_odometry = two_lidars, predicts_odometry
        self._first: deque[Scan] = deque()
        self._second: deque[Scan] = deque()
        self._taken: deque[float] = deque(maxlen=INTERVALS + 1)  # middles of the first lidar's last scans
        self._arrived: deque[float] = deque(maxlen=INTERVALS + 1)  # the same of the second lidar
        self._not_waited = -np.inf  # stamp of the reading of odometry after which none is waited for
        self._latest = self._beginning = -np.inf  # middles of the latest and of the earliest scan of the first lidar

    def __len__(self) -> int:
        """Return the number of the first lidar's scans."""
        return len(self._first)

    @property
    def scans(self) -> list[Scan]:
        """All scans in the queue, those of the first lidar before those of the second."""
        return [*self._first, *self._second]

    @property
    def earliest(self) -> float:
        """Stamp of the earliest scan, inf without one."""
        return min((queue[0].stamp for queue in (self._first, self._second) if queue), default=np.inf)

    @property
    def is_empty(self) -> bool:
        """True if no scan of either lidar waits."""
        return not self._first and not self._second

    @property
    def is_full(self) -> bool:
        """True if more scans wait, and for longer, than should."""
        if len(self) <= MAX_QUEUED_SCANS:
            return False
        return self._first[-1].stamp - self._first[0].stamp > MAX_QUEUED_SECONDS

    def add(self, scan: Scan) -> None:
        """Append a scan."""
        middle = sweep_middle(scan)
        if scan.lidar:
            self._two_lidars = True
            self._arrived.append(middle)
            self._second.append(scan)
            return
        self._latest = middle
        self._beginning = middle if np.isinf(self._beginning) else self._beginning
        self._first.append(scan)

    def drop_oldest(self) -> None:
        """Drop the first lidar's oldest scan, and those of the second that are not later."""
        self._drop_second(sweep_middle(self._first.popleft()))

    def take(self, covered: float, *, flush: bool = False) -> ScanPair | None:
        """Remove and return the oldest scan of the first lidar with its partner; None if it has to wait.

        covered  stamp up to which odometry is known, seconds
        flush    no more messages will come, so that nothing is waited for

        A scan that would have to wait is also returned if the queue is full, and so are those after it until odometry
        goes on.
        """
        if not self._first:
            return None
        scan = self._first[0]
        if self.is_full and _end(scan) > covered:
            self._not_waited = covered
        waits = not flush and covered > self._not_waited
        if waits and _end(scan) > covered:
            return None
        low, high = self._window(sweep_middle(scan)) if self._two_lidars else (-np.inf, -np.inf)
        partner = next((one for one in self._second if low <= sweep_middle(one) <= high), None)
        if waits and partner is None and self._two_lidars and self._is_expected(high):
            return None
        if waits and partner is not None and _end(partner) > covered and not self._predicts_odometry:
            return None
        self._first.popleft()
        self._taken.append(sweep_middle(scan))
        self._drop_second(low if partner is None else sweep_middle(partner))
        return ScanPair(scan, partner)

    def _window(self, middle: float) -> tuple[float, float]:
        """Return the earliest and the latest middle of the partner of a scan of the first lidar, from its middle."""
        begin, end = WINDOW_WITHOUT_ODOMETRY if self._predicts_odometry else WINDOW
        interval = _interval([*self._taken, middle])
        return middle + begin * interval, middle + end * interval

    def _is_expected(self, stamp: float) -> bool:
        """Return True if a scan of the second lidar that has not arrived yet may have its middle before a stamp."""
        arrived = self._arrived[-1] if self._arrived else -np.inf
        if self._latest - max(arrived, self._beginning) > MAX_ABSENCE:
            return False
        return arrived + EARLIEST * _interval(self._arrived) <= stamp

    def _drop_second(self, middle: float) -> None:
        """Drop the scans of the second lidar whose middle is not later than `middle`."""
        while self._second and sweep_middle(self._second[0]) <= middle:
            self._second.popleft()


def _end(scan: Scan) -> float:
    return scan.stamp + scan.duration


def _interval(middles: deque[float] | list[float]) -> float:
    """Return the median of the seconds between scans, MAX_PERIOD at most: scans farther apart are not paired."""
    if len(middles) < 2:
        return USUAL_PERIOD
    return min(float(np.median(np.diff(middles))), MAX_PERIOD)

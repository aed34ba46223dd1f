"""The finished drive as arrays: all that the checks look at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from ..matching.point_matcher import MIN_KNOWN_POINTS
from ..odometry.history import wheel_travel

# Metres and radians of motion between two scans that are checked: scans nearer to each other show nothing new.
# Origin: chosen, about half the distance of keyframes; not measured.
SAMPLE_DISTANCE, SAMPLE_TURN = 0.3, math.radians(10.0)
# Returns below which a scan is not checked. Origin: definition, as many as matching needs.
MIN_POINTS = MIN_KNOWN_POINTS


@immutable
class Drive:
    """n scans in time order with their final poses, and the odometry between them.

    stamps      (n,) seconds
    poses       (n, 3) final poses of the base in the map
    odometry    (n, 3) odometry poses, without systematic errors as far as they are known
    segment     (n,) number of the segment: within one, odometry is continuous and no scan to be checked was dropped
    points      n arrays (p, 2), the valid returns in the base's frame, metres
    deviations  (4,) standard deviations of the random errors of odometry, see `OdometryModel.deviations`
    floors      (2,) standard deviations of a single odometry reading, metres and radians
    measured    (n,) False for scans to which odometry does not lead, as it was missing or failing
    dropped     (n,) True for scans whose points were dropped, as in familiar places: they matched the map while driving
    has_odometry  False if the motions are predicted at constant velocity throughout
    start       stamp (seconds) from which times in texts are counted
    readings    (m,) stamps of the odometry readings; between two of them odometry is interpolated. Without any, there
                is one at each scan
    """

    stamps: Floats
    poses: Floats
    odometry: Floats
    segment: Integers
    points: Sequence[Floats]
    deviations: Floats
    floors: Floats
    measured: NDArray[np.bool_]
    dropped: NDArray[np.bool_]
    has_odometry: bool = True
    start: float = 0.0
    readings: Floats = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.stamps)

    def sampled(self) -> Drive:
        """Return the drive with those scans only that are SAMPLE_DISTANCE or SAMPLE_TURN apart and not empty."""
        counts = np.array([len(points) for points in self.points], dtype=np.int64)
        rows = _sample(self.odometry, self.poses, (counts >= MIN_POINTS) | self.dropped)
        apart = np.cumsum(self.dropped[rows])  # segments end where a scan would have been checked that was dropped
        kept = ~self.dropped[rows]
        rows, apart = rows[kept], apart[kept]
        unmeasured = np.cumsum(~self.measured)[rows]
        return replace(
            self,
            stamps=self.stamps[rows],
            poses=self.poses[rows],
            odometry=self.odometry[rows],
            segment=self.segment[rows] + apart,
            points=[np.ascontiguousarray(self.points[row], dtype=np.float64) for row in rows.tolist()],
            measured=np.diff(unmeasured, prepend=0) == 0,  # at all scans since the one before
            dropped=self.dropped[rows],
        )

    def between_readings(self, first: int, last: int) -> tuple[int, int]:
        """Return the rows `first` and `last`, moved apart until the odometry readings around both lie between them.

        Odometry is interpolated from one reading to the next: it may be wrong in between, but not over the whole of it.
        The rows of the first and of the last scan are the limit.
        """
        if not len(self.readings):
            return first, last
        before = np.searchsorted(self.readings, self.stamps[first], side="right") - 1
        after = np.searchsorted(self.readings, self.stamps[last])
        if before >= 0:
            first = max(int(np.searchsorted(self.stamps, self.readings[before], side="right")) - 1, 0)
        if after < len(self.readings):
            last = min(int(np.searchsorted(self.stamps, self.readings[after])), len(self) - 1)
        return first, last

    def travelled(self) -> Floats:
        """Return the metres of wheel travel (n,) along the path up to each scan."""
        steps = wheel_travel(se2.between(self.poses[:-1], self.poses[1:]))
        return np.concatenate([np.zeros(min(1, len(self))), np.cumsum(steps)])

    def departures(self, first: Integers, last: Integers) -> tuple[Floats, Floats]:
        """Compare path and odometry over motions from the scans `first` (m,) to the scans `last` (m,).

        Return the motion along the path relative to that of odometry (m, 3), and its squared Mahalanobis distance (m,)
        under odometry's error model. The distance is infinite if odometry is not continuous in between.
        """
        measured = se2.between(self.odometry[first], self.odometry[last])
        error = se2.between(measured, se2.between(self.poses[first], self.poses[last]))
        squared = (error**2 / self.variances(measured)).sum(axis=-1)
        return error, np.where(self.segment[first] == self.segment[last], squared, np.inf)

    def variances(self, motion: Floats) -> Floats:
        """Return the variances (m, 3) of odometry's motions (m, 3)."""
        travel, rates = wheel_travel(motion), self.deviations**2
        position, reading = self.floors**2
        heading = rates[2] * travel + rates[3] * np.abs(motion[..., 2]) + reading
        return np.stack([rates[0] * travel**2 + position, rates[1] * travel**2 + position, heading], axis=-1)


@compiled
def _sample(odometry, poses, checked):  # type: ignore[no-untyped-def]
    """Return the rows, of those to be `checked`, that odometry or path moved far enough from the row before."""
    rows = np.zeros(len(poses), dtype=np.int64)
    count = 0
    for k in range(len(poses)):
        if not checked[k]:
            continue
        chosen = count == 0
        for path in (odometry, poses):
            if not chosen:
                moved = path[k] - path[rows[count - 1]]
                turn = abs((moved[2] + math.pi) % (2 * math.pi) - math.pi)
                chosen = math.hypot(moved[0], moved[1]) >= SAMPLE_DISTANCE or turn >= SAMPLE_TURN
        if chosen:
            rows[count] = k
            count += 1
    return rows[:count]

"""Detect that two scans in a row show different places although the wheels hardly moved between them.

A robot that is lifted does not drive, so only such scans are evidence that it was kidnapped. While a robot drives, the
view changes by the motion itself, which may be wrong, and by what comes into sight or into the range of the lidar. In a
large hall two scans in a row may have little in common. If scans of a driving robot fit nowhere, the map or the
estimated trajectory is wrong.

Two neighbouring beams of a scan show a surface between their ranges, however far apart the beams are. A point of the
next scan agrees if it lies on that surface. In directions without neighbouring beams nothing is compared.
"""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined
from drivers.immutable import immutable
from drivers.messages import Odometry
from features.rays import MISSING_STEPS

from ..geometry.angles import wrap_angle
from ..geometry.median import median
from ..geometry.segments import Floats
from ..geometry.significance import MOST
from ..geometry.surroundings import INDOOR_RANGE
from ..matching.scan_points import subsample
from ..odometry.dead_reckoning import DeadReckoning
from ..odometry.history import wheel_travel

# (n, 3) errors [x, y, heading] of odometry between two scans that are tried (metres, metres, radians).
# Origin: chosen, 0.1 m and 16 degrees in steps of 0.1 m and 2 degrees; with steps of 8 degrees one pair of scans of a
# simulated drive was taken for different places.
ODOMETRY_ERRORS = np.stack(
    np.meshgrid([-0.1, 0.0, 0.1], [-0.1, 0.0, 0.1], np.radians(np.arange(-16.0, 16.1, 2.0)), indexing="ij"), axis=-1
).reshape(-1, 3)
# Share of agreeing points above which two scans show the same place. Origin: definition, most of them. Consecutive
# scans of nine recordings and six simulated drives, some with 30 points, reach at least 0.58. The medians of scans from
# elsewhere are 0 to 0.44 on these drives, except for 0.85 in a bare corridor.
SAME_PLACE_SHARE = MOST
# Metres beyond the ranges of the neighbouring beams within which a point agrees. Origin: chosen, what the steps of
# ODOMETRY_ERRORS leave: 0.05 m, and 1 degree, which is 0.1 m at a range of 6 m; not measured.
MARGIN = 0.15
# Metres around the robot within which points are compared. Origin: definition.
COMPARED_RADIUS = INDOOR_RANGE
# Metres around the robot within which they are not: the largest error of the position in ODOMETRY_ERRORS turns nearer
# points by more than the largest one of the heading. Origin: definition.
NOT_COMPARED_RADIUS = ODOMETRY_ERRORS[:, 0].max() / np.tan(ODOMETRY_ERRORS[:, 2].max())
# Points of a scan that are compared with others, evenly subsampled. Origin: chosen, for speed; not measured.
MAX_COMPARED_POINTS = 120
# Points that a scan without walls needs to be tracked, and both scans of a comparison: few points fit nearly
# everywhere. Origin: chosen; not measured.
MIN_POINTS = 30
# Metres of wheel travel between two scans above which the robot has driven. Origin: definition, the largest error in
# ODOMETRY_ERRORS: within it the pose of a robot that stands, or is lifted, is known as well as the comparison needs.
MAX_TRAVEL = 0.1

# Metres of wheel travel for which a changed view counts as recent: look-alike places differ some way on.
# Origin: definition, what is seen from there has been left behind then.
VIEW_CHANGE_MEMORY = INDOOR_RANGE


@immutable
class View:
    """Points (p, 2) of a scan in the base's frame, and the reading of odometry at the scan."""

    odometry: Odometry
    points: Floats

    @property
    def compared(self) -> Floats:
        """Points (p, 2) that are compared with another scan."""
        return np.asarray(self.points[_are_compared(self.points)])

    @property
    def comparable(self) -> bool:
        """True if the scan has enough points for a comparison."""
        return bool(np.count_nonzero(_are_compared(self.points)) >= MIN_POINTS)

    def differs_from(self, other: View, motion: se2.Pose) -> bool:
        """Return True if another view, after a `motion` [x, y, heading] from this one, shows another place.

        False if they cannot be compared: either has too few points, or the robot has driven in between.
        """
        if not self.comparable or not other.comparable or wheel_travel(motion) > MAX_TRAVEL:
            return False
        bearings, ranges = np.arctan2(self.points[:, 1], self.points[:, 0]), np.hypot(*self.points.T)
        order = np.argsort(bearings)
        order = order[ranges[order] > NOT_COMPARED_RADIUS]
        bearings, ranges = bearings[order], ranges[order]
        limit = MISSING_STEPS * median(np.diff(bearings))
        points = np.ascontiguousarray(subsample(other.compared, MAX_COMPARED_POINTS))
        poses = se2.compose(motion, ODOMETRY_ERRORS)
        return bool(_agreeing_share(bearings, ranges, points, poses, limit) < SAME_PLACE_SHARE)


class ViewComparison:
    """Comparison of the view of each suspicious scan with the last ones; recent changes are kept.

    A robot may be lifted during a sweep. That scan then shows both places, and agrees with the scans before and after.
    So a scan that fits nowhere is also compared with the view before the last one.
    """

    def __init__(self) -> None:
        self._views: list[View] = []  # the last two with enough points for a comparison, the last one first
        self._last: Odometry | None = None  # at the last scan
        self._travel_since_change = np.inf  # metres

    @property
    def changed(self) -> bool:
        """True if the view has changed abruptly within the last metres."""
        return bool(self._travel_since_change < VIEW_CHANGE_MEMORY)

    def add(self, view: View, dead_reckoning: DeadReckoning, *, suspicious: bool, fits_nowhere: bool) -> bool:
        """Add the view of a scan. Return True if the scan is suspicious and shows another place than the last one.

        No scan is suspicious if odometry does not measure the motion: the robot may have driven in between.

        fits_nowhere  True if a suspicious scan fits at no pose that the robot can have reached
        """
        if self._last is not None:
            self._travel_since_change += float(wheel_travel(se2.between(self._last.pose, view.odometry.pose)))
        differs = suspicious and self._differs(view, dead_reckoning, 2 if fits_nowhere else 1)
        if differs:
            self._travel_since_change = 0.0
        self._last = view.odometry
        if view.comparable:
            self._views = [view, *self._views[:1]]
        return differs

    def _differs(self, view: View, dead_reckoning: DeadReckoning, count: int) -> bool:
        """Return True if a view shows another place than one of the last `count`, or if it is the first one.

        False without enough points for a comparison.
        """
        if not self._views:
            return self._last is None
        motions = [dead_reckoning.motion(other.odometry, view.odometry) for other in self._views[:count]]
        return any(other.differs_from(view, motion) for other, motion in zip(self._views, motions, strict=False))


@compiled
def _are_compared(points):  # type: ignore[no-untyped-def]
    """Return (p,) which of points (p, 2) in the base's frame are compared with other scans."""
    compared = np.empty(len(points), np.bool_)
    for k in range(len(points)):
        squared = points[k, 0] * points[k, 0] + points[k, 1] * points[k, 1]
        compared[k] = NOT_COMPARED_RADIUS * NOT_COMPARED_RADIUS < squared < COMPARED_RADIUS * COMPARED_RADIUS
    return compared


@compiled
def _agreeing_share(bearings, ranges, points, poses, limit):  # type: ignore[no-untyped-def]
    """Return the largest share, at one of several poses, of a scan's points that agree with another scan.

    bearings, ranges  (n,) of the other scan's points, by bearing, radians and metres
    points            (p, 2) of the scan
    poses             (q, 3) of the scan in the frame of the other one
    limit             angle between neighbours in the other scan beyond which nothing is known between them, radians

    A pose at which less than half of the points can be compared does not count; if none counts, the share is 1.
    """
    count, best = len(bearings), -1.0
    for q in range(len(poses)):
        c, s = math.cos(poses[q, 2]), math.sin(poses[q, 2])
        agreeing, compared = 0, 0
        for p in range(len(points)):
            x = poses[q, 0] + c * points[p, 0] - s * points[p, 1]
            y = poses[q, 1] + s * points[p, 0] + c * points[p, 1]
            bearing, distance = math.atan2(y, x), math.hypot(x, y)
            after = _first_not_below(bearings, bearing) % count
            before = (after - 1) % count
            if abs(wrap_angle(bearings[after] - bearings[before])) <= limit:
                compared += 1
                low, high = min(ranges[before], ranges[after]), max(ranges[before], ranges[after])
                agreeing += low - MARGIN <= distance <= high + MARGIN
        if 2 * compared >= len(points):
            best = max(best, agreeing / compared)
    return best if best >= 0.0 else 1.0


@inlined
def _first_not_below(values, least):  # type: ignore[no-untyped-def]
    """Return the first row of sorted values that is not below `least`; written out, as NumPy's compiles for long."""
    low, high = 0, len(values)
    while low < high:
        middle = (low + high) // 2
        if values[middle] < least:
            low = middle + 1
        else:
            high = middle
    return low

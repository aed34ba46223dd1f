"""Detect that two scans in a row show different places although the wheels hardly moved between them.

A robot that is lifted does not drive, so only such scans are evidence that it was kidnapped. Between scans of a driving
robot the view changes by the motion itself, which may be wrong, by what comes into sight behind other surfaces, and by
what comes into the range of the lidar: in a large hall two scans in a row may have little in common. If its scans fit
nowhere, the map or the estimated trajectory is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..matching.distance_field import DistanceField
from ..matching.point_costs import likelihoods
from ..matching.scan_points import subsample
from ..odometry.history import wheel_travel

# (n, 3) errors [x, y, heading] of odometry between two scans that are tried (metres, metres, radians).
# Origin: chosen, 0.1 m and 16 degrees in steps of 0.1 m and 2 degrees. Steps of 8 degrees lost one scan of a simulated
# drive that scored 0.38.
ODOMETRY_ERRORS = np.stack(
    np.meshgrid([-0.1, 0.0, 0.1], [-0.1, 0.0, 0.1], np.radians(np.arange(-16.0, 16.1, 2.0)), indexing="ij"), axis=-1
).reshape(-1, 3)
# Likelihood score above which two scans show the same place. Origin: measured. Consecutive scans of a driving robot
# reach it in 98.5 % and more of cases on recordings and always in simulation with worn wheels; pairs of scans from
# anywhere in a building reach it in 1 to 2 %, in buildings with look-alike places in 25 to 52 %.
SAME_PLACE_SCORE = 0.5
# Metres around the robot within which points are compared. Origin: chosen, a usual range indoors; not measured.
FIELD_RADIUS = 12.0
# Points that are compared, evenly subsampled. Origin: chosen, for speed; not measured.
MAX_COMPARED_POINTS = 120
# Points that both scans need for a comparison; few points fit nearly everywhere. Origin: chosen; not measured.
MIN_POINTS = 30
# Metres of wheel travel between two scans above which the robot has driven. Origin: definition, the largest error in
# ODOMETRY_ERRORS: within it the pose of a robot that stands, or is lifted, is known as well as the comparison needs.
MAX_TRAVEL = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Points (p, 2) of a scan in the base's frame, and the odometry pose at the scan."""

    odometry: se2.Pose
    points: Floats

    @property
    def near(self) -> Floats:
        """Points (p, 2) that are compared: others may be outside the field of the other view."""
        return self.points[np.hypot(self.points[:, 0], self.points[:, 1]) < FIELD_RADIUS]

    @property
    def comparable(self) -> bool:
        """True if the scan has enough points for a comparison."""
        return len(self.near) >= MIN_POINTS

    def differs_from(self, other: View, motion: se2.Pose) -> bool:
        """Return True if another view, after a `motion` [x, y, heading] from this one, shows another place.

        False if they cannot be compared: either has too few points, or the robot has driven in between.
        """
        if not self.comparable or not other.comparable or wheel_travel(motion) > MAX_TRAVEL:
            return False
        field = DistanceField.empty(np.zeros(2), FIELD_RADIUS + MAX_TRAVEL)
        field.insert(np.zeros(3), self.points)
        points = np.ascontiguousarray(subsample(other.near, MAX_COMPARED_POINTS))  # strided ones: see `match_points`
        return bool(likelihoods(field, points, se2.compose(motion, ODOMETRY_ERRORS)).max() < SAME_PLACE_SCORE)

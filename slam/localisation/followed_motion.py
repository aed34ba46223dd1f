"""Hypothesis that odometry stands still for some scans in a row, while the robot moves on evenly.

If the robot is slow, or the lidar measures often, one scan is no evidence: between two scans the robot moves by less
than the errors of the map. So the estimate stands still with odometry, its velocity becomes zero, and a motion at this
velocity is no alternative any more. Therefore the pose of a robot that moves on evenly is followed beside that by
odometry, and the evidence of the scans against odometry is added up (sequential test of Wald). The hypothesis is
refuted if the sum contradicts it.

Scans are compared again after the two poses have come a cell farther apart, or closer together: until then the same
points meet the same surfaces, and repeat the errors of these. That wheels spin while the robot stands is not tested in
this way: in a bare corridor, people who walk with the robot are all that tells these cases apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from features.normal_limits import NORMAL_LIMIT

from ..matching.offset_tiles import FIELD_CELL
from ..matching.point_matcher import MAX_SEARCH_SHIFT, PointMatch, Prediction, information_of
from ..odometry.history import wheel_travel
from ..odometry.velocity import VelocityFilter
from .match_target import MIN_EVIDENCE
from .odometry_comparison import GROSS_SHARE
from .prediction_error import PREDICTION_SIGMAS

Compare: TypeAlias = Callable[[Prediction, se2.Pose], tuple[PointMatch | None, float]]
"""Compares a scan at a prediction and at a pose by odometry, see `MatchTarget.compare`."""


@immutable
class FollowedMotion:
    """Pose of a robot that has moved on evenly, whatever odometry says.

    start     [x, y, heading] of the base in the map when odometry last agreed with the even motion
    pose      the same at the last comparison; before the first one, when the hypothesis began
    velocity  when the hypothesis began
    seconds   time since `pose`
    duration  time since the hypothesis began, seconds
    apart     (3,) pose by odometry relative to the followed one at the last comparison; None before the first one
    evidence  (nats) of all compared scans against odometry
    """

    start: se2.Pose
    pose: se2.Pose
    velocity: VelocityFilter
    seconds: float = 0.0
    duration: float = 0.0
    apart: se2.Pose | None = None
    evidence: float = 0.0

    @classmethod
    def begin(cls, pose: se2.Pose, velocity: VelocityFilter) -> FollowedMotion:
        """Return the hypothesis that odometry stands still from now on, where the robot is at a pose in the map."""
        return cls(pose, pose, velocity.copy())

    def after(self, seconds: float) -> FollowedMotion:
        """Return the hypothesis some seconds later."""
        return FollowedMotion(
            self.start, self.pose, self.velocity,
            self.seconds + seconds, self.duration + seconds, self.apart, self.evidence,
        )  # fmt: skip

    def moved(self, before: se2.Pose, after: se2.Pose) -> FollowedMotion:
        """Return the hypothesis in a map that was corrected, by which a pose `before` has become `after`."""
        start, pose = (se2.compose(after, se2.between(before, one)) for one in (self.start, self.pose))
        return replace(self, start=start, pose=pose)

    def prediction(self, cost: float = 0.0) -> Prediction:
        """Return the prediction of the present pose; `cost` see `Prediction`."""
        sigmas = np.sqrt(self.velocity.variances) * self.seconds + PREDICTION_SIGMAS
        return Prediction(self.present_pose, information_of(sigmas), cost)

    @property
    def present_pose(self) -> se2.Pose:
        """Followed pose at the present scan: `pose`, and the motion since then."""
        return se2.compose(self.pose, self.velocity.motion(self.seconds))

    @property
    def is_too_uncertain(self) -> bool:
        """True if the robot may be farther from the followed pose than poses are searched."""
        sigma = math.sqrt(float(self.velocity.variances[:2].max()))
        return NORMAL_LIMIT * sigma * self.duration > MAX_SEARCH_SHIFT

    def compared(self, pose: se2.Pose, compare: Compare) -> FollowedMotion | None:
        """Return the hypothesis after a scan that was tracked at a `pose` by odometry.

        Returns None if the hypothesis is refuted, or too uncertain to be followed any farther.
        """
        if self.is_too_uncertain:
            return None
        present = self.present_pose
        before = np.zeros(3) if self.apart is None else self.apart
        if float(wheel_travel(se2.between(present, pose) - before)) < FIELD_CELL:
            return replace(self, start=pose) if self.apart is None else self
        if not self._stands_still(present, pose):  # true of most scans: the comparison takes longer
            return None
        predicted = self.prediction()
        match, evidence = compare(predicted, pose)
        followed = predicted.pose if match is None else match.pose
        total = self.evidence + evidence - 0.5 * predicted.squared_distance(followed)
        if total <= -MIN_EVIDENCE or predicted.excludes(followed) or not self._stands_still(followed, pose):
            return None
        return replace(self, pose=followed, seconds=0.0, apart=se2.between(followed, pose), evidence=total)

    def _stands_still(self, followed: se2.Pose, odometry: se2.Pose) -> bool:
        """Return True if the way to a pose by odometry is grossly shorter than that to the followed pose."""
        travel, of_odometry = (float(wheel_travel(se2.between(self.start, pose))) for pose in (followed, odometry))
        return of_odometry < GROSS_SHARE * travel

"""Results and stored state of tracking."""

from __future__ import annotations

from dataclasses import field, replace
from enum import Enum

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Odometry
from drivers.small_matrices import inverse

from ..geometry.degeneracy import MIN_INFORMATION
from ..geometry.pose_steps import pose_error
from ..geometry.segments import Floats
from ..matching.line_matcher import Registration
from ..matching.point_matcher import Prediction
from ..odometry.velocity import VelocityFilter
from .prediction_error import PredictionError
from .slip_statistics import SlipStatistics
from .small_objects import SmallObjects

# Information (3, 3) of a pose that makes that of any scan invertible. Origin: definition.
CONDITIONING = MIN_INFORMATION * np.eye(3)


class TrackingStatus(Enum):
    """Outcome of tracking one scan."""

    TRACKED = "tracked"  # matched
    TENTATIVE = "tentative"  # matched far from odometry: the next scans decide
    FAILED = "failed"  # fits nowhere near
    NO_FEATURES = "no features"  # too little wall and too few points


@immutable
class TrackingResult:
    """Pose of a scan.

    pose          [x, y, heading] of the base in the map, from the scan's points and the prediction
    covariance    (3, 3) of this pose in the map as it stands, in the base's frame
    registration  of the scan's features with the landmarks
    registered_covariance  (3, 3) of the registered pose, in the base's frame
    predicted     pose from which both were found, with its information (3, 3)
    explained     0 to 1, see `ScanMatch`
    known         number of points in space that was seen before
    poor          True if a considerable part of these points does not fit
    slipped       True if odometry's motion since the reference contradicts the pose
    fits_by_chance  True if the scan fits here although its view has changed abruptly: the status is then FAILED, and
                    the robot may have been kidnapped to a place that looks alike
    from_tentative  True if the pose was found from the tentative pose of the scan before, which it confirms if this
                    scan is TRACKED
    contradicts_old_map  True if the scan was matched to the last metres alone, as these and odometry contradict the map
                         of earlier passes
    """

    pose: se2.Pose
    covariance: Floats
    registration: Registration
    registered_covariance: Floats
    predicted: Prediction
    status: TrackingStatus
    explained: float
    known: int
    poor: bool
    slipped: bool
    fits_by_chance: bool
    from_tentative: bool = False
    contradicts_old_map: bool = False

    @property
    def scan_pose(self) -> se2.Pose:
        """Registered pose without the share of the prediction, which its information must determine.

        With the information M of the scan and P of the prediction p, the registered pose x fulfils
        M (x - s) + P (x - p) = 0, so that the scan alone gives s = x + M^-1 P (x - p).
        """
        pose, prediction = self.registration.pose, self.predicted
        pull = prediction.information @ pose_error(prediction.pose, pose)
        return se2.compose(pose, inverse(self.registration.total_information + CONDITIONING) @ pull)

    def motion_since(self, before: se2.Pose | None) -> se2.Pose | None:
        """Return the motion from the pose of the scan `before`; None if one of the scans was not matched."""
        matched = self.status in (TrackingStatus.TRACKED, TrackingStatus.TENTATIVE)
        return se2.between(before, self.pose) if before is not None and matched else None


@immutable
class PoseFix:
    """Pose of the base in the map, and the reading of odometry at the same time.

    covariance  (3, 3) of the pose in the map, in its own frame; zero after a keyframe, as the covariances of the
                landmarks around it are relative to this keyframe
    """

    pose: se2.Pose
    odometry: Odometry
    covariance: Floats = field(default_factory=lambda: np.zeros((3, 3)))

    def shifted(self, seconds: float) -> PoseFix:
        """Return the fix with some seconds added to its stamp."""
        return replace(self, odometry=replace(self.odometry, stamp=self.odometry.stamp + seconds))


@immutable
class TrackerState:
    """State of tracking that a session stores.

    fix         last pose fix
    reference   from which odometry predicts
    since_fix   seconds from the last fix to the last scan; None if no slip is possible before the next fix
    scan_stamp  seconds, of the last scan; None before the first one of a part of the map
    intervals   seconds between the latest scans, see `MeasurementClock`
    velocity    (3,) see `VelocityFilter`
    velocity_variances  (3,)
    prediction_variances  (3,) see `PredictionError`
    prediction_scans  number of scans that they rest on
    slips       numbers of tracked scans and of slips
    small_objects  numbers of small objects, and of those that have moved
    contradicted_for  seconds for which odometry has contradicted the scans, see `OdometryComparison`
    last_score  match score of the last tracked scan
    """

    fix: PoseFix
    reference: PoseFix
    since_fix: float | None
    scan_stamp: float | None
    intervals: tuple[float, ...]
    velocity: Floats
    velocity_variances: Floats
    prediction_variances: Floats
    prediction_scans: int
    slips: SlipStatistics
    small_objects: SmallObjects
    contradicted_for: float
    last_score: float

    def shifted(self, seconds: float) -> TrackerState:
        """Return the state with some seconds added to its stamps."""
        stamp = None if self.scan_stamp is None else self.scan_stamp + seconds
        fix, reference = self.fix.shifted(seconds), self.reference.shifted(seconds)
        return replace(self, fix=fix, reference=reference, scan_stamp=stamp)

    @classmethod
    def placed(cls, fix: PoseFix) -> TrackerState:
        """Return the state of a robot of which nothing but the pose is known."""
        velocity, error = VelocityFilter(), PredictionError()
        return cls(
            fix, fix, None, None, (), velocity.velocity, velocity.variances, error.variances, error.scans,
            SlipStatistics(), SmallObjects(), 0.0, 0.0,
        )  # fmt: skip

"""Predictions of the pose at the next scan, by each hypothesis that is followed."""

from __future__ import annotations

from drivers import se2
from drivers.immutable import immutable

from ..matching.point_matcher import Prediction
from .followed_motion import FollowedMotion
from .tracking import PoseFix


@immutable
class Predictions:
    """Predictions of the pose at the next scan, one of which holds.

    usual           by odometry; without it, and while it is failing, that of an even motion
    slip            if odometry has slipped since the last scan, or the motion is not even; None if neither is possible
    followed        hypothesis that is the reason for `slip` if odometry has slipped for several scans; else None
    caught_up       if odometry has caught up after a recent slip; None without one
    from_tentative  from the tentative pose of the last scan, by odometry and by an even motion; empty without one
    evidence        (nats) of earlier scans against the usual one, see `MatchTarget.match`
    """

    usual: Prediction
    slip: Prediction | None = None
    followed: FollowedMotion | None = None
    caught_up: Prediction | None = None
    from_tentative: tuple[Prediction, ...] = ()
    evidence: float = 0.0

    @property
    def all(self) -> list[Prediction]:
        """All predictions, the usual one first."""
        others = (self.slip, self.caught_up, *self.from_tentative)
        return [self.usual, *(prediction for prediction in others if prediction is not None)]


@immutable
class Alternative:
    """Pose where a scan fits odometry too, and by how much it costs more there than at its best pose."""

    pose: se2.Pose
    additional_cost: float


@immutable
class TentativePose:
    """Pose of a scan that is TENTATIVE, on which the next scan decides.

    fix          pose by which odometry has slipped
    alternative  pose by which it has not; None if the scan does not fit there
    evidence     (nats) for a slip, of this scan and of earlier ones
    followed     hypothesis from which it was found if odometry has slipped for several scans; else None
    """

    fix: PoseFix
    alternative: Alternative | None
    evidence: float
    followed: FollowedMotion | None = None

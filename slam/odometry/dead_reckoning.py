"""Motions of the base by odometry, without its systematic errors and with covariances."""

from __future__ import annotations

import copy

from drivers import se2
from drivers.messages import Odometry

from ..geometry.segments import Floats
from .error_model import OdometryModel
from .history import OdometryHistory


class DeadReckoning:
    """Readings of odometry and their error model: the motion between any two moments.

    model    learned errors of the readings
    history  readings, up to the last scan at least; without them, a motion is corrected as one arc
    """

    def __init__(self, model: OdometryModel, history: OdometryHistory | None = None) -> None:
        self.model, self.history = model, OdometryHistory() if history is None else history

    def __deepcopy__(self, memo: dict[int, object]) -> DeadReckoning:
        """Return a copy with a model of its own. It shares the readings: later ones do not change earlier motions."""
        return DeadReckoning(copy.deepcopy(self.model, memo), self.history)

    def motion(self, begin: Odometry, end: Odometry) -> se2.Pose:
        """Return the motion [x, y, heading] of the base from one reading to a later one."""
        return self.model.motion_along(self.history.path(begin, end))

    def motion_and_covariance(self, begin: Odometry, end: Odometry) -> tuple[se2.Pose, Floats]:
        """Return the motion from one reading to a later one, and its covariance (3, 3), in its end frame."""
        return self.model.motion_and_covariance(self.history.path(begin, end))

    def motions(self, stamps: Floats, poses: Floats) -> Floats:
        """Return the motions (n - 1, 3) of the base from each of n readings to the next one.

        stamps, poses  (n,) seconds, increasing, and (n, 3) of the readings
        """
        return self.model.motions_along(poses, self.history.paths(stamps))

    def motions_and_covariances(self, stamps: Floats, poses: Floats) -> tuple[Floats, Floats]:
        """Return the same motions with their covariances (n - 1, 3, 3), in their end frames."""
        return self.model.motions_and_covariances(poses, self.history.paths(stamps))

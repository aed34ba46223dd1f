"""Error model of motions that are predicted at constant velocity, as there is no odometry."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from ..config import OdometryConfig
from ..geometry.normal_distribution import NORMAL_MEDIAN, PLANE_MEDIAN
from ..geometry.pose_covariance import POSE_SIGMAS
from .error_model import OdometryModel
from .systematic_errors import PRIOR_SAMPLES, SystematicErrors

# Metres and radians: errors of a prediction before any driving. Origin: chosen, an acceleration of 1 m/s^2 or 3 rad/s^2
# for half a second.
INITIAL_FLOORS = np.array([0.12, 0.37])
# Metres and radians: smallest errors of a prediction, which no wheels have measured. Origin: definition, the noise of
# the poses that the velocity is taken from.
MIN_FLOORS = POSE_SIGMAS[1:]
# Metres: without odometry, the motion is not determined in a direction in which the standard deviation of registration
# exceeds this: then it rests on one object, which may fit by chance, as the last points of a corridor's walls do at the
# end of the lidar's range. Origin: geometry, five points with a standard deviation of 0.03 m.
BLIND_SIGMA = 0.03 / math.sqrt(5.0)
# Metres per metre: error of a predicted motion that nothing corrects. Origin: chosen, robots often become half as fast,
# or half as fast again.
BLIND_ERROR = 0.5
# Metres over which this error is common to neighbouring motions. Origin: chosen, robots change their speed every few
# seconds; not measured.
BLIND_LENGTH = 2.0


class PredictedMotionModel(OdometryModel):
    """Errors of motions predicted at constant velocity, learned by comparing them with registration.

    They have no systematic part. A prediction errs by the acceleration since the last scan: the error belongs to each
    motion, however short, and its standard deviation is estimated from the median of the errors. Motions that are not
    corrected for a while err in proportion to the travel, as those of wheels.
    """

    measured = False
    unobserved_sigma = BLIND_SIGMA

    def __init__(self, config: OdometryConfig) -> None:
        super().__init__(config)
        self._floors, self._systematic = INITIAL_FLOORS, SystematicErrors(variances=np.zeros(6))

    def begin_drive(self) -> None:
        """Keep the learned errors: they are accelerations of the robot, which do not depend on its wheels."""

    def _estimate(self) -> None:
        if not len(self._samples):  # as in a saved model of a robot that stood: the initial errors hold
            return
        measured, registered, variances = self._latest_samples()
        self._estimate_rates(measured, registered, variances)
        error = se2.between(measured, registered)
        squared = np.array(
            [
                np.median(error[:, 0] ** 2 + error[:, 1] ** 2) / PLANE_MEDIAN,
                np.median(error[:, 2] ** 2) / NORMAL_MEDIAN,
            ]
        )
        weight = len(error) / (len(error) + PRIOR_SAMPLES)
        self._floors = INITIAL_FLOORS ** (1 - weight) * np.maximum(np.sqrt(squared), MIN_FLOORS) ** weight

    @property
    def _shared_rate(self) -> float:
        return BLIND_ERROR**2 * BLIND_LENGTH  # nothing measures the motion


def motion_model(config: OdometryConfig) -> OdometryModel:
    """Return the error model of the motions between scans, by where they come from."""
    return OdometryModel(config) if config.source == "wheels" else PredictedMotionModel(config)

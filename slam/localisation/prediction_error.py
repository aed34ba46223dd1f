"""Error of the pose that odometry predicts from the last keyframe, beside that of odometry's own motion.

It comes from the error of the keyframe's pose, from the clocks of lidar and odometry, and from the mount. On one robot
it is a few millimetres, on another some centimetres. So its variance is learned from scans that determine their pose:
it rises and falls by steps until half of the squared differences between predicted and matched poses are below the
median of their distribution (stochastic approximation of a quantile, Robbins and Monro 1951). A gross error moves it by
one step only.

Equations: docs/mathematics.md#predictions.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled

from ..geometry.normal_distribution import NORMAL_MEDIAN, NORMAL_MEDIAN_ERROR
from ..geometry.pose_covariance import POSE_SIGMAS
from ..geometry.segments import Floats
from ..odometry.error_model import RANDOM_ERROR_SAMPLES
from ..odometry.systematic_errors import PRIOR_SAMPLES

# Metres, metres, radians: standard deviations before any scan. Origin: definition, those of the poses.
PREDICTION_SIGMAS = POSE_SIGMAS
# Variance of a match in any direction, as a share of PREDICTION_SIGMAS squared, up to which it determines the error of
# the prediction. Origin: chosen, a third in standard deviations; not measured.
MAX_MATCH_SHARE = 0.1
MAX_MATCH_VARIANCES = MAX_MATCH_SHARE * PREDICTION_SIGMAS**2  # Origin: definition.


class PredictionError:
    """Variances of the error of predictions in x, y and heading, in the base's frame.

    variances   (3,) square metres, square metres, square radians
    covariance  (3, 3) the same as a matrix, not to be changed
    scans       number of scans that they rest on, at most RANDOM_ERROR_SAMPLES
    """

    def __init__(self, variances: Floats | None = None, scans: int = 0) -> None:
        self.variances = PREDICTION_SIGMAS**2 if variances is None else variances
        self.scans = scans
        self.covariance = np.diag(self.variances)

    def add(self, difference: Floats, predicted: Floats, match: Floats) -> None:
        """Learn from the difference (3,) of the matched from the predicted pose of a scan.

        predicted  (3, 3) covariance of the prediction, with `variances`
        match      (3, 3) that of the match; a scan that does not determine its pose is not used
        """
        samples = self.scans + PRIOR_SAMPLES
        # No other step gives a smaller error in the end: it is 1 / (2 f(m) m) with the density f at the median.
        step = NORMAL_MEDIAN_ERROR / samples
        # Less than the standard error of the whole variance cannot be told from the rest of it.
        least = NORMAL_MEDIAN_ERROR / math.sqrt(samples)
        used, variances = _adapted(
            self.variances, difference, predicted, match, float(np.exp(-step)), float(np.exp(step)), least
        )
        if used:
            self.variances, self.scans = variances, min(self.scans + 1, RANDOM_ERROR_SAMPLES)
            self.covariance = np.diag(variances)


@compiled
def _adapted(variances, difference, predicted, match, lower, higher, least):  # type: ignore[no-untyped-def]
    """Return if a scan determines its pose, and the variances (3,) after it.

    lower, higher  factors by which a variance falls or rises
    least          of the variance of the whole difference, to which it falls at least
    """
    used, adapted = True, np.empty(3)
    for k in range(3):
        used = used and not match[k, k] > MAX_MATCH_VARIANCES[k]
        expected = predicted[k, k] + match[k, k]
        if difference[k] * difference[k] > NORMAL_MEDIAN * expected:
            adapted[k] = variances[k] * higher
        else:
            adapted[k] = max(variances[k] * lower, min(variances[k], least * expected))
    return used, adapted

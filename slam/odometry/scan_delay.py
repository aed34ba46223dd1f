"""Delay of the scans' stamps against odometry's, estimated from the keyframes of a finished run.

If scans are stamped d seconds late, the motion m between two of them is the one that odometry measured d seconds
earlier, o(d). Where the robot's velocity changes between the two, this differs from what odometry measured between the
stamps. With the derivative j of o by d and the errors e = m - o(d) of all motions, Gauss-Newton steps give

    d <- d + sum w z'W e / sum w z'W j,    variance sum (w z'W e)^2 / (sum c z'W j)^2,

with the information W of odometry's motion, the weights w = 1 / (1 + u^2) of the Cauchy kernel for the relative error
u, and its curvature c = w^2 (1 - u^2). The derivative is a difference of odometry's readings, whose errors would draw
the estimate to zero. So z is the derivative from other readings, just before and after those of j: an
instrumental variable (Wald 1940). The variance (Huber 1967) includes errors that W does not describe; it is large if
the robot hardly changed its velocity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers import se2
from drivers.timing.robust_weights import ROBUST_SIGMAS
from features.normal_limits import NORMAL_LIMIT

from ..geometry.segments import Floats
from .error_model import OdometryModel
from .history import OdometryHistory
from .measurement_clock import USUAL_PERIOD

# Seconds to either side for the derivative, or the interval of odometry's readings if that is longer: j and z must not
# share readings. Origin: chosen, the motors of robots need longer than the 0.3 s of j and z to change their speed.
STEP = 0.05
# Gauss-Newton steps; the second one changes a delay of 0.1 s by a hundredth. Origin: numerical.
ITERATIONS = 4
# Seconds; standard deviation of the delay before the drive: longer delays than a period are found before the run.
PRIOR_SIGMA = USUAL_PERIOD


@dataclass(frozen=True, slots=True)
class ScanDelay:
    """Seconds by which scans are stamped late, negative if odometry is, and the standard deviation.

    interval  seconds between two readings of odometry, in which the motion is only interpolated
    """

    seconds: float
    sigma: float
    interval: float = 0.0

    @property
    def significant(self) -> bool:
        """True if clocks that agree would show such a delay in 0.3 % of drives."""
        return abs(self.seconds) > NORMAL_LIMIT * self.sigma

    def row(self) -> dict[str, object]:
        """Return the delay as plain data."""
        return {"seconds": round(self.seconds, 5), "sigma": round(self.sigma, 5), "significant": self.significant}


def estimate_scan_delay(stamps: Floats, poses: Floats, history: OdometryHistory, model: OdometryModel) -> ScanDelay:
    """Return the delay of scans at the `stamps` (n,) and `poses` (n, 3) in the map.

    history  odometry that leads from each scan to the next
    """
    unknown = ScanDelay(0.0, PRIOR_SIGMA)
    if len(stamps) < 2 or len(history) < 2:
        return unknown
    interval = float(np.median(np.diff(history.stamps)))
    step = max(STEP, interval)
    registered = se2.between(poses[:-1], poses[1:])
    seconds, curvature, score = 0.0, 0.0, np.zeros(0)
    for _ in range(ITERATIONS):
        shifts = step * np.array([-3.0, -1.0, 0.0, 1.0, 3.0])
        first, before, at, after, last = _motions(stamps - seconds - shifts[:, None], history, model)
        slope = se2.between(before, after) / (2.0 * step)
        instrument = (se2.between(first, before) + se2.between(after, last)) / (4.0 * step)
        error = se2.between(at, registered)
        weights = np.linalg.inv(np.array([model.covariance(motion) for motion in at]))
        squared = np.einsum("ki,kij,kj->k", error, weights, error)
        relative = squared / (ROBUST_SIGMAS**2 * np.median(squared) + np.finfo(float).tiny)
        robust, weighted = 1.0 / (1.0 + relative), np.einsum("ki,kij->kj", instrument, weights)
        information = np.einsum("ki,ki->k", weighted, slope)
        if not robust @ information > 0.0:
            return unknown
        curvature = float((robust**2 * (1.0 - relative)) @ information)
        score = robust * np.einsum("ki,ki->k", weighted, error)
        seconds += float(score.sum() / (robust @ information))
    if not curvature > 0.0:
        return unknown
    sigma = float(np.sqrt((score**2).sum())) / curvature
    share = PRIOR_SIGMA**2 / (PRIOR_SIGMA**2 + sigma**2)
    return ScanDelay(share * seconds, float(np.sqrt(share)) * sigma, interval)


def _motions(stamps: Floats, history: OdometryHistory, model: OdometryModel) -> Floats:
    """Return the motions (m, n - 1, 3) between stamps (m, n) by odometry without its systematic errors."""
    known, poses = history.stamps, history.poses
    after = np.clip(np.searchsorted(known, stamps), 1, len(known) - 1)
    part = np.clip((stamps - known[after - 1]) / (known[after] - known[after - 1]), 0.0, 1.0)
    steps = part[..., None] * se2.between(poses[after - 1], poses[after])
    at = se2.compose(poses[after - 1], steps)
    return model.correct(se2.between(at[:, :-1], at[:, 1:]))

"""Whether the estimate's covariances are honest: normalised estimation error squared (NEES).

For errors e of k dimensions and their covariances P, e' P^-1 e follows a chi-square distribution with k degrees of
freedom if the covariances are right (Bar-Shalom, Li, Kirubarajan, Estimation with Applications, 2001, section 5.4).
A mean above its band says that the estimate is overconfident, below that it is needlessly cautious.

The band of a mean holds for independent values. Those of one run are not: an error that the first keyframe makes is in
all that follow. So a run counts as one draw, with the mean of its values, whose expectation is still k. The chi-square
band for one value a run then holds whatever the correlation within runs, since the mean of correlated values scatters
at most as much as one of them. How much the runs' means did scatter is told beside it, as the standard error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..errors import MapError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Consistency:
    """The mean of `count` NEES values of `dimensions` degrees of freedom, and the band it should lie in.

    The band holds for independent values: take them from different runs, as `run_consistency` does. `standard_error` is
    that of the mean, as the values scatter; NaN for a single one.
    """

    mean: float
    low: float
    high: float
    count: int
    dimensions: int
    standard_error: float

    @property
    def consistent(self) -> bool:
        """Whether the mean lies within the band."""
        return self.low <= self.mean <= self.high


def pose_nees(estimates: Floats, covariances: Floats, truth: Floats) -> Floats:
    """(n,) NEES of poses (n, 3); covariances (n, 3, 3) of [x, y, heading] in the estimated pose's own frame (GTSAM)."""
    return nees(se2.between(estimates, truth), covariances)


def point_nees(estimates: Floats, covariances: Floats, truth: Floats) -> Floats:
    """(n,) NEES of points such as corners (n, 2) with covariances (n, 2, 2)."""
    return nees(truth - estimates, covariances)


def line_nees(frames: Floats, covariances: Floats, truth: Floats) -> Floats:
    """(n,) NEES of walls: `frames` (n, 3) on the estimated walls, x along the wall, `truth` (n, 3) on the true ones.

    The covariances (n, 2, 2) are of offset and heading at the estimated frame's origin. Where along the true wall its
    frame stands does not matter; which way it runs does.
    """
    seen = se2.between(frames, truth)
    offset = seen[:, 1] - seen[:, 0] * np.tan(seen[:, 2])
    return nees(np.column_stack([offset, seen[:, 2]]), covariances)


def nees(errors: Floats, covariances: Floats) -> Floats:
    """(n,) e' P^-1 e of errors (n, k) and covariances (n, k, k). Raises MapError where a covariance is singular."""
    try:
        weighted = np.linalg.solve(covariances, errors[..., None])[..., 0]
    except np.linalg.LinAlgError as error:
        raise MapError("a covariance is singular") from error
    return np.asarray(np.sum(errors * weighted, axis=-1))


def consistency(values: Floats, dimensions: int, probability: float = 0.95) -> Consistency:
    """The mean of NEES `values` (n,) and the band that holds it with `probability` if the covariances are right."""
    if len(values) == 0:
        raise MapError("there is no NEES value to take the mean of")
    degrees = len(values) * dimensions
    low, high = (chi_square_quantile(p, degrees) / len(values) for p in (0.5 - probability / 2, 0.5 + probability / 2))
    error = float(np.std(values, ddof=1)) / len(values) ** 0.5 if len(values) > 1 else float("nan")
    return Consistency(float(np.mean(values)), low, high, len(values), dimensions, error)


def run_consistency(runs: Sequence[Floats], dimensions: int, probability: float = 0.95) -> Consistency:
    """The same for NEES values (n,) of several runs, each of which counts as one draw; NaN values are left out."""
    means = [float(np.nanmean(values)) for values in runs if np.isfinite(values).any()]
    return consistency(np.array(means), dimensions, probability)


def chi_square_quantile(probability: float, degrees: int) -> float:
    """Quantile of the chi-square distribution by Wilson and Hilferty (1931): its cube root is nearly normal.

    Between 1 and 99 % right to 1 % from 10 degrees of freedom on, to 0.1 % from 30; NEES means have hundreds.
    """
    spread = 2 / (9 * degrees)
    return float(degrees * max(1 - spread + NormalDist().inv_cdf(probability) * spread**0.5, 0.0) ** 3)

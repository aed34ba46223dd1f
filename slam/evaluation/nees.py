"""Test the consistency of covariances by the normalised estimation error squared (NEES).

For errors e of k dimensions with covariances P, e' P^-1 e follows a chi-square distribution with k degrees of freedom
if the covariances are correct (Bar-Shalom, Li, Kirubarajan, Estimation with Applications, 2001, section 5.4). A mean
above its confidence band means overconfident covariances, a mean below it too cautious ones.

The band of a mean holds for independent values. Values of one run are correlated: an error of the first keyframe
affects all later ones. Each run therefore counts as one sample, with the mean of its values, whose expectation is still
k. The chi-square band for one value per run holds for any correlation within runs, because the variance of the mean of
correlated values is at most that of one of them. The standard error of the runs' means is reported as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2

from ..errors import MapError
from ..geometry.chi_square import chi_square_quantile
from ..geometry.segments import Floats

GROSS = 0.999
"""Probability of the chi-square quantile beyond which a single value is a gross error."""


@dataclass(frozen=True, slots=True)
class Consistency:
    """Mean of `count` NEES values of `dimensions` degrees of freedom, and its confidence band.

    The band holds for independent values, i.e. from different runs, as in `run_consistency`. `standard_error` is that
    of the mean, from the scatter of the values; NaN for a single value.
    """

    mean: float
    low: float
    high: float
    count: int
    dimensions: int
    standard_error: float

    @property
    def consistent(self) -> bool:
        """True if the mean is within the band."""
        return self.low <= self.mean <= self.high


def pose_nees(estimates: Floats, covariances: Floats, truth: Floats) -> Floats:
    """Return the NEES (n,) of poses (n, 3).

    Covariances (n, 3, 3) of [x, y, heading] are in the estimated pose's own frame (GTSAM's convention).
    """
    return nees(se2.between(estimates, truth), covariances)


def point_nees(estimates: Floats, covariances: Floats, truth: Floats) -> Floats:
    """Return the NEES (n,) of points such as corners (n, 2) with covariances (n, 2, 2)."""
    return nees(truth - estimates, covariances)


def line_nees(frames: Floats, covariances: Floats, truth: Floats) -> Floats:
    """Return the NEES (n,) of walls.

    frames       (n, 3) on the estimated walls, x along the wall
    covariances  (n, 2, 2) of offset and heading at the estimated frame's origin
    truth        (n, 3) on the true walls, anywhere along them, x in the same direction
    """
    relative = se2.between(frames, truth)
    offset = relative[:, 1] - relative[:, 0] * np.tan(relative[:, 2])
    return nees(np.column_stack([offset, relative[:, 2]]), covariances)


def nees(errors: Floats, covariances: Floats) -> Floats:
    """Return e' P^-1 e (n,) of errors (n, k) and covariances (n, k, k). Raises MapError if a covariance is singular."""
    try:
        weighted = np.linalg.solve(covariances, errors[..., None])[..., 0]
    except np.linalg.LinAlgError as error:
        raise MapError("a covariance is singular") from error
    return np.asarray(np.sum(errors * weighted, axis=-1))


def consistency(values: Floats, dimensions: int, probability: float = 0.95) -> Consistency:
    """Return the mean of NEES `values` (n,), and the band that contains it with `probability` if consistent.

    Raises MapError without values.
    """
    if len(values) == 0:
        raise MapError("there is no NEES value to average")
    degrees = len(values) * dimensions
    low, high = (chi_square_quantile(p, degrees) / len(values) for p in (0.5 - probability / 2, 0.5 + probability / 2))
    error = float(np.std(values, ddof=1)) / len(values) ** 0.5 if len(values) > 1 else float("nan")
    return Consistency(float(np.mean(values)), low, high, len(values), dimensions, error)


def run_consistency(runs: Sequence[Floats], dimensions: int) -> Consistency:
    """Return the consistency of NEES values (n,) of several runs, each counted as one sample; NaN is skipped."""
    means = [float(np.nanmean(values)) for values in runs if np.isfinite(values).any()]
    return consistency(np.array(means), dimensions)

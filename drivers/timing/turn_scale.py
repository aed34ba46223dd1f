"""Compare the turns that a sensor measures with those of the lidar: their scale, which shows units and mirrored axes.

Between pairs of scans, the turn x of the sensor is compared with the turn y of the lidar from scan matching,

    x = g y + b T,

with the scale g, the bias b of the sensor's rates, and the duration T. Weights lower the influence of wrong matches and
of slipping wheels. The standard deviation is that of the jackknife over the pairs, which computes the weights anew
without each of them: a single one may decide which of few turns are outliers, and pairs at rest agree with any scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..messages import Floats
from .delay import MAX_SCALE
from .motion_pairs import covered_pairs, jackknife_sigma
from .robust_weights import WEIGHT_ITERATIONS, robust_weights
from .student import ERROR_PROBABILITY, MIN_VALUES, upper_limit
from .turns import MAX_ROTATION_SIGMA, Run


@dataclass(frozen=True)
class TurnScale:
    """Turns of a sensor, as multiples of those of the lidar.

    found  scale as found
    sigma  its standard deviation
    pairs  pairs of scans between which turns were compared
    """

    found: float
    sigma: float
    pairs: int

    def decide(self, others: Sequence[float]) -> float | None:
        """Return 1 unless that is certainly wrong, else the one of some other scales that is right, or None."""
        reach = self.sigma * upper_limit(ERROR_PROBABILITY, self.pairs - 1)
        if self.found - reach < MAX_SCALE and self.found + reach > 1.0 / MAX_SCALE:
            return 1.0
        return next((one for one in others if 1.0 / MAX_SCALE < self.found / one < MAX_SCALE), None)

    def __str__(self) -> str:
        return f"{self.found:.3g} ± {self.sigma:.2g} times the turns that the scans show"


def estimate_turn_scale(runs: Sequence[Run], stamps: Floats, angles: Floats, max_period: float) -> TurnScale | None:
    """Return the scale of a sensor's angles (m,) at stamps (m,); None if the data do not determine it.

    They do not if the lidar's turns are within the errors of scan matching: these draw the scale to zero, as if the
    sensor did not measure what the scans show.

    max_period  seconds between stamps at most, to interpolate between them
    """
    rows = np.array([row for run in runs for row in _turns_between(run, stamps, angles, max_period)])
    if len(rows) < MIN_VALUES or np.sqrt(np.mean(rows[:, 0] ** 2)) < MAX_ROTATION_SIGMA:
        return None
    try:
        found = _robust_scale(rows)
        without_one = np.array([_robust_scale(np.delete(rows, k, axis=0)) for k in range(len(rows))])
    except np.linalg.LinAlgError:  # nothing turned
        return None
    sigma = jackknife_sigma(without_one - found)
    return TurnScale(found, sigma, len(rows)) if np.isfinite([found, sigma]).all() else None


def _robust_scale(rows: Floats) -> float:
    """Return the scale over pairs (n, 3) of which some are outliers. Raises LinAlgError if they do not determine it."""
    inputs, weighted = rows[:, :2], rows[:, :2]
    for _ in range(WEIGHT_ITERATIONS):
        found = np.linalg.solve(weighted.T @ inputs, weighted.T @ rows[:, 2])
        weighted = robust_weights(np.abs(rows[:, 2] - inputs @ found))[:, None] * inputs
    return float(np.linalg.solve(weighted.T @ inputs, weighted.T @ rows[:, 2])[0])


def _turns_between(run: Run, stamps: Floats, angles: Floats, max_period: float) -> list[tuple[float, float, float]]:
    """Return the turn of the lidar, the duration, and the turn of the sensor between the pairs of a run."""
    turns = []
    for first, second in covered_pairs(run, stamps, max_period):
        begin, end = run.stamps[[first, second]]
        before, after = np.interp([begin, end], stamps, angles)
        turned = run.poses[second, 2] - run.poses[first, 2]
        turns.append((float(turned), float(end - begin), float(after - before)))
    return turns

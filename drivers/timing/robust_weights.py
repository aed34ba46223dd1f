"""Weights that lower the influence of samples with gross errors, such as wrong matches or slipping wheels."""

from __future__ import annotations

import numpy as np

from ..messages import Floats

# Typical errors at which the weight of a sample is a half. Origin: chosen, usual for robust weights.
ROBUST_SIGMAS = 3.0
# Times that the weights are computed. Origin: numerical.
WEIGHT_ITERATIONS = 10
# Radians, least typical error. Origin: numerical.
MIN_ERROR = 1e-5


def robust_weights(errors: Floats) -> Floats:
    """Return the weights (n,) of samples with errors (n,) in radians, not negative; the typical one is the median."""
    return np.asarray(1.0 / (1.0 + (errors / (ROBUST_SIGMAS * (np.median(errors) + MIN_ERROR))) ** 2))

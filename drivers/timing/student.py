"""Student's distribution: significance of a mean of few values, and the levels of the tests.

Only this would be needed of SciPy, and importing that takes as long as reading a recording of some minutes.
"""

from __future__ import annotations

import math

import numpy as np

from ..messages import Floats

# Probability of changing what a recording states although it is right. Origin: chosen, so that no user meets it: less
# than one in all drives of many robots.
ERROR_PROBABILITY = 1e-6
# Probability below which the scans contradict what was found from them. Origin: chosen, the usual level of a test: an
# error that is not compensated does less harm than a wrong compensation.
CONTRADICTION_PROBABILITY = 0.05
# Values for a test at least. Origin: chosen; Student's quantiles for fewer are beyond any data, and a jackknife of
# fewer says little about the standard deviation.
MIN_VALUES = 8


def statistic(values: Floats) -> float:
    """Return the mean of values (n,) divided by its standard error, n > 1."""
    error = float(values.std(ddof=1)) / np.sqrt(len(values))
    return float(values.mean()) / max(float(error), 1e-12)


def upper_limit(probability: float, freedom: int) -> float:
    """Return what a variable with `freedom` degrees of freedom exceeds with a probability, above 0 and at most 0.5."""
    low, high = 0.0, 0.5 * math.pi  # of the angle whose tangent is the limit divided by sqrt(freedom)
    while low < (middle := 0.5 * (low + high)) < high:
        if _exceeding(middle, freedom) > probability:
            low = middle
        else:
            high = middle
    return math.sqrt(freedom) * math.tan(low)


def _exceeding(angle: float, freedom: int) -> float:
    """Return the probability of exceeding sqrt(freedom) tan(angle), a finite sum (Abramowitz and Stegun 26.7.3-4)."""
    c, odd = math.cos(angle), freedom % 2
    term, total = (c if odd else 1.0), 0.0
    for k in range(1 + odd, freedom, 2):
        total += term
        term *= c * c * k / (k + 1)
    within = math.sin(angle) * total
    return 0.5 - 0.5 * (2.0 / math.pi * (angle + within) if odd else within)

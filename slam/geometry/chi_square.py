"""The chi-square distribution: `scipy.special` has it too, but takes a quarter of a second to load."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from .segments import Floats

# Half of a value from which on its tail is none that doubles can tell from zero. Origin: numerical.
MAX_HALF = 700.0
# Degrees of freedom up to which quantiles are exact. Origin: numerical, the time grows with them.
EXACT_DOF = 100


def chi_square_tail(dof: int, squared: Floats) -> Floats:
    """Return the probability (n,) that a chi-square variable is larger than each of the values `squared` (n,).

    `dof` are its degrees of freedom, at least 1. With x half of a value it is Q(dof / 2, x), the incomplete gamma
    function, and Q(a + 1, x) = Q(a, x) + x^a exp(-x) / Gamma(a + 1), from Q(1/2, x) = erfc(sqrt(x)) or Q(1, x) =
    exp(-x) on.
    """
    half = np.minimum(0.5 * np.asarray(squared, dtype=np.float64), MAX_HALF)
    density, order = np.exp(-half), 0.5 if dof % 2 else 1.0
    tail = np.array([math.erfc(math.sqrt(value)) for value in half.tolist()]) if dof % 2 else density
    while order < 0.5 * dof:
        tail = tail + half**order * density / math.gamma(order + 1.0)
        order += 1.0
    return tail


def chi_square_quantile(probability: float, dof: int) -> float:
    """Return the value that a chi-square variable does not exceed with a probability, above 0 and below 1.

    Of more than EXACT_DOF degrees of freedom, by Wilson and Hilferty (1931): its cube root is nearly normal. Between 1
    and 99 %, this is exact to 0.05 %.
    """
    if dof > EXACT_DOF:
        spread = 2 / (9 * dof)
        return float(dof * (1 - spread + NormalDist().inv_cdf(probability) * spread**0.5) ** 3)
    low, high = 0.0, 2.0 * MAX_HALF
    while low < (middle := 0.5 * (low + high)) < high:
        if chi_square_tail(dof, np.array([middle]))[0] > 1.0 - probability:
            low = middle
        else:
            high = middle
    return low

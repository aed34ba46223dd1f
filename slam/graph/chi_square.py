"""Chi-square distribution, without SciPy, whose special functions take half a second to import."""

from __future__ import annotations

import math
from functools import cache


def chi_square_tail(squared: float, dof: int) -> float:
    """Return the probability that a chi-square variable with `dof` degrees of freedom, 1 or more, exceeds `squared`.

    By the recurrence Q(k + 2) = Q(k) + (x/2)^(k/2) exp(-x/2) / Gamma(k/2 + 1) from one or two degrees of freedom.
    """
    if squared <= 0.0:
        return 1.0
    if math.isinf(squared):
        return 0.0
    half = 0.5 * squared
    tail = math.erfc(math.sqrt(half)) if dof % 2 else math.exp(-half)
    for k in range(2 - dof % 2, dof, 2):
        tail += math.exp(0.5 * k * math.log(half) - half - math.lgamma(0.5 * k + 1.0))
    return tail


@cache
def chi_square_gate(probability: float, dof: int) -> float:
    """Return the value that a chi-square variable with `dof` degrees of freedom exceeds with a probability, 0 to 1."""
    low, high = 0.0, 1.0
    while chi_square_tail(high, dof) > probability:
        high *= 2.0
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if chi_square_tail(middle, dof) > probability else (low, middle)
    return high

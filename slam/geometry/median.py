"""Median of numbers, for compiled functions and for Python, and the weighted median.

The median is in a function of its own: numba would compile its version of NumPy's for each function that calls it.
"""

from __future__ import annotations

import numpy as np

from drivers.compiled import compiled

from .segments import Floats


@compiled
def median(values):  # type: ignore[no-untyped-def]
    """Return the median of a contiguous array (n,)."""
    return np.median(values)


def weighted_median(values: Floats, weights: Floats) -> float:
    """Return the least of the values (n,) up to which the weights (n,) add up to half of all, or more.

    `np.quantile` with weights gives the same, but takes almost four times as long for a thousand values.
    """
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(sums, 0.5 * sums[-1])]])

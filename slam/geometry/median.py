"""Median of numbers, for compiled functions and for Python.

It is in a function of its own: numba would compile its version of NumPy's median for each function that calls it.
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
    """Return the least of values (n,) such that it and smaller ones have half of the positive weights (n,)."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, 0.5 * total[-1])]])

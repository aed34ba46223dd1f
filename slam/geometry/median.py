"""Median of numbers, for compiled functions and for Python.

It is in a function of its own: numba would compile its version of NumPy's median for each function that calls it.
"""

from __future__ import annotations

import numpy as np

from drivers.compiled import compiled


@compiled
def median(values):  # type: ignore[no-untyped-def]
    """Return the median of a contiguous array (n,)."""
    return np.median(values)

"""Which of some numbers are among others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .segments import Integers


def is_among(numbers: Integers, others: Integers) -> NDArray[np.bool_]:
    """Return (n,) True for the numbers (n,) that are among others (m,); none is negative.

    A table is filled up to the largest of them, as for indices of keyframes and ids of landmarks. `np.isin` takes
    five to ten times as long to find out if that is worth it.
    """
    present = np.zeros(1 + max(numbers.max(initial=-1), others.max(initial=-1)), dtype=bool)
    present[others] = True
    return np.asarray(present[numbers])

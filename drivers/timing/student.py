"""Student's distribution: significance of a mean of few values.

Of `scipy.stats` only this is needed, and importing that takes as long as reading a recording of some minutes.
"""

from __future__ import annotations

import numpy as np

from ..messages import Floats


def statistic(values: Floats) -> float:
    """Return the mean of values (n,) divided by its standard error, n > 1."""
    error = float(values.std(ddof=1)) / np.sqrt(len(values))
    return float(values.mean()) / max(float(error), 1e-12)


def upper_limit(probability: float, freedom: int) -> float:
    """Return what a variable with `freedom` degrees of freedom exceeds with a probability."""
    from scipy.special import stdtrit  # only here: recordings without turns do not need it

    return float(-stdtrit(freedom, probability))

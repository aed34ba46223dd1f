"""Pairs of scans whose motions are compared with those of another sensor, and the jackknife over them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..messages import Floats
from .delay import SPAN
from .turns import Run


def covered_pairs(run: Run, stamps: Floats, max_period: float) -> Iterator[tuple[int, int]]:
    """Yield the consecutive pairs of scans of a run, SPAN apart or more, between which a sensor has measured.

    stamps      (m,) of the sensor's readings, seconds, increasing
    max_period  seconds between these at most, to interpolate between them
    """
    first = 0
    while (second := int(np.searchsorted(run.stamps, run.stamps[first] + SPAN))) < len(run.stamps):
        begin, end = run.stamps[first], run.stamps[second]
        low, high = np.searchsorted(stamps, [begin, end])
        around = stamps[max(0, low - 1) : high + 1]
        if len(around) > 1 and around[0] <= begin and around[-1] >= end and np.diff(around).max() < max_period:
            yield first, second
        first = second


def leave_one_out(normal: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Return the solution (k,) of the normal equations summed over n pairs, and those (n, k) without one pair each.

    normal  (n, k, k) matrices of the pairs
    right   (n, k) right sides of the pairs

    Raises LinAlgError if the pairs do not determine the solution.
    """
    matrix, values = normal.sum(axis=0), right.sum(axis=0)
    without = np.linalg.solve(matrix - normal, (values - right)[:, :, None])[:, :, 0]
    return np.linalg.solve(matrix, values), without


def jackknife_sigma(differences: Floats) -> float:
    """Return the standard deviation of an estimate from the differences (n,) of those without one pair each."""
    count = len(differences)
    return float(np.sqrt((count - 1) / count * (differences**2).sum()))

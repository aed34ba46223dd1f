"""Walls that were mapped twice: two frames on what is one wall, found when both have been seen well enough to tell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from .local_map import LocalMap
from .segments import Floats

GATE = 5.99  # squared Mahalanobis distance, chi-square with 2 degrees of freedom at 95 %: they must agree
WIDEST_OFFSET = 0.10  # metres between two walls that may be one, where they overlap
WIDEST_HEADING = math.radians(4.0)
LEAST_OVERLAP = 0.2  # metres along the wall
LEAST_OBSERVATIONS = 3


@dataclass(frozen=True, slots=True)
class Duplicate:
    """Rows of the local map that show one wall; the second's frame lies `along` the first (metres); squared Mahalanobis
    distance between them."""

    first: int
    second: int
    along: float
    distance: float


def find_duplicate(
    local_map: LocalMap, mature: NDArray[np.bool_], seen: NDArray[np.bool_], flatness: float
) -> Duplicate | None:
    """The most certain pair of walls of the local map that are one, None where there is none.

    `mature` (n,) says which walls have been observed often enough, `seen` (n,) which were seen just now: a pair must
    have one of those. Walls are compared in the middle of their overlap, with the covariances as seen from the robot,
    so what is uncertain about the robot's own place does not count; `flatness` is the variance of their unevenness.
    """
    rows = np.flatnonzero(mature)
    if len(rows) < 2:
        return None
    frame, low, high = local_map.frame[rows], local_map.low[rows], local_map.high[rows]
    other = se2.between(frame[:, None], frame[None, :])  # (n, n, 3): the second wall's frame in the first's
    turn = other[..., 2]
    along = other[..., 0]
    start = np.maximum(low[:, None], along + low[None, :])
    end = np.minimum(high[:, None], along + high[None, :])
    middle = 0.5 * (start + end)
    offset = other[..., 1] + (middle - along) * np.tan(turn)
    candidate = (np.abs(turn) < WIDEST_HEADING) & (np.abs(offset) < WIDEST_OFFSET) & (end - start > LEAST_OVERLAP)
    candidate &= np.triu(seen[rows][:, None] | seen[rows][None, :], 1)
    best: Duplicate | None = None
    for i, j in np.argwhere(candidate):
        at_first = _carried(local_map.wall_covariance[rows[i]], middle[i, j])
        at_second = _carried(local_map.wall_covariance[rows[j]], middle[i, j] - along[i, j])
        overlap = end[i, j] - start[i, j]
        difference = np.array([offset[i, j], turn[i, j]])
        distance = float(
            difference
            @ np.linalg.solve(at_first + at_second + np.diag([flatness, 12 * flatness / overlap**2]), difference)
        )
        if distance < GATE and (best is None or distance < best.distance):
            best = Duplicate(int(rows[i]), int(rows[j]), float(along[i, j]), distance)
    return best


def _carried(covariance: Floats, along: float) -> Floats:
    carry = np.array([[1.0, along], [0.0, 1.0]])
    return np.asarray(carry @ covariance @ carry.T)

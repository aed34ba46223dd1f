"""Walls that were mapped twice: two frames on what is one wall, found when both have been seen well enough to tell.

While the robot drives, what is around it is compared as it is known from there; once it has come to rest, all of the
map with the joint covariances of the graph.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats
from ..graph.factor_graph import FactorGraph
from .landmarks import Landmarks
from .local_map import LocalMap

GATE = 5.99  # squared Mahalanobis distance, chi-square with 2 degrees of freedom at 95 %: they must agree
WIDEST_OFFSET = 0.10  # metres between two walls that may be one, where they overlap
WIDEST_HEADING = math.radians(4.0)
LEAST_OVERLAP = 0.2  # metres along the wall
MIN_OBSERVATIONS_TO_MERGE = 3  # keyframes, where only what is known from the robot's place tells two walls apart


@dataclass(frozen=True, slots=True)
class Duplicate:
    """Rows of the local map that show one wall; the second's frame lies `along` the first (metres); squared Mahalanobis
    distance between them."""

    first: int
    second: int
    along: float
    distance: float


@dataclass(frozen=True, slots=True)
class Overlap:
    """Two walls, `first` and `second`, that run along one another for `length` metres.

    The second's frame lies `along` the first (metres); in the `middle` of what they share, also measured along the
    first, the second is `offset` (metres) across and turned by `turn` (radians).
    """

    first: int
    second: int
    along: float
    middle: float
    length: float
    offset: float
    turn: float

    def distance(self, covariance: Floats, roughness: float) -> float:
        """Squared Mahalanobis distance between the two, given the `covariance` (2, 2) of offset and turn, to which
        the variance of their unevenness is added."""
        difference = np.array([self.offset, self.turn])
        uneven = np.diag([roughness, 12 * roughness / self.length**2])
        return float(difference @ np.linalg.solve(covariance + uneven, difference))


def find_duplicate_wall(
    local_map: LocalMap, mature: NDArray[np.bool_], seen: NDArray[np.bool_], roughness: float
) -> Duplicate | None:
    """The most certain pair of walls of the local map that are one, None where there is none.

    `mature` (n,) says which walls have been observed often enough, `seen` (n,) which were seen just now: a pair must
    have one of those. Walls are compared in the middle of their overlap, with the covariances as seen from the robot,
    so what is uncertain about the robot's own place does not count; `flatness` is the variance of their unevenness.
    """
    rows = np.flatnonzero(mature)
    if len(rows) < 2:
        return None
    pairs = overlaps(local_map.frame[rows], local_map.low[rows], local_map.high[rows])
    best: Duplicate | None = None
    for pair in pairs:
        first, second = int(rows[pair.first]), int(rows[pair.second])
        if not (seen[first] or seen[second]):
            continue
        at_first = _carried(local_map.wall_covariance[first], pair.middle)
        at_second = _carried(local_map.wall_covariance[second], pair.middle - pair.along)
        distance = pair.distance(at_first + at_second, roughness)
        if distance < GATE and (best is None or distance < best.distance):
            best = Duplicate(first, second, pair.along, distance)
    return best


def merge_duplicate_walls(
    landmarks: Landmarks, graph: FactorGraph, roughness: float, merge: Callable[[int, int], None]
) -> int:
    """Have `merge` make one of each pair of walls (kept, absorbed) that are one, the most certain first; returns how
    many there were.

    All confirmed walls are compared with their joint covariances in the graph; `flatness` is the variance of their
    unevenness.
    """
    walls = landmarks.walls.rows
    rows = np.flatnonzero(walls["in_graph"] & landmarks.active())
    alike = overlaps(walls["frame"][rows], walls["low"][rows], walls["high"][rows])
    pairs = np.array([rows[[pair.first, pair.second]] for pair in alike], dtype=np.int64).reshape(-1, 2)
    found = []
    for pair, (first, second), joint in zip(alike, pairs.tolist(), graph.wall_pair_covariances(pairs), strict=True):
        distance = pair.distance(_relative(joint, pair), roughness)
        if distance < GATE:
            found.append((distance, first, second))
    merged = 0
    for _, first, second in sorted(found):
        if walls["merged_into"][first] == first and walls["merged_into"][second] == second:
            merge(first, second)
            merged += 1
    return merged


def overlaps(frame: Floats, low: Floats, high: Floats) -> list[Overlap]:
    """All pairs of walls, of frames (n, 3) and known from `low` to `high` (n,), that run alike along one another."""
    other = se2.between(frame[:, None], frame[None, :])  # (n, n, 3): the second wall's frame in the first's
    turn = other[..., 2]
    along = other[..., 0]
    start = np.maximum(low[:, None], along + low[None, :])
    end = np.minimum(high[:, None], along + high[None, :])
    middle = 0.5 * (start + end)
    offset = other[..., 1] + (middle - along) * np.tan(turn)
    alike = (np.abs(turn) < WIDEST_HEADING) & (np.abs(offset) < WIDEST_OFFSET) & (end - start > LEAST_OVERLAP)
    return [
        Overlap(int(i), int(j), along[i, j], middle[i, j], end[i, j] - start[i, j], offset[i, j], turn[i, j])
        for i, j in np.argwhere(np.triu(alike, 1))
    ]


def _carried(covariance: Floats, along: float) -> Floats:
    carry = np.array([[1.0, along], [0.0, 1.0]])
    return np.asarray(carry @ covariance @ carry.T)


def _relative(joint: Floats, pair: Overlap) -> Floats:
    """(2, 2): covariance of offset and turn between two walls in the middle of what they share, from their joint
    covariance (4, 4), each at its own frame."""
    jacobian = np.array([[-1.0, -pair.middle, 1.0, pair.middle - pair.along], [0.0, -1.0, 0.0, 1.0]])
    return np.asarray(jacobian @ joint @ jacobian.T)

"""Walls anywhere on the map that are one."""

from __future__ import annotations

import numpy as np

from ..graph import FactorGraph
from ..landmarks import Landmarks
from ..merging import GATE, LEAST_OBSERVATIONS, Overlap, overlaps
from ..segments import Floats


def merge_everywhere(landmarks: Landmarks, graph: FactorGraph, flatness: float) -> int:
    """Make one of all pairs of walls that are, the most certain first; returns how many there were.

    The walls are compared with their joint covariances in the graph, which does not hear of it.
    """
    walls = landmarks.walls.rows
    active = walls["in_graph"] & landmarks.standing()
    rows = np.flatnonzero(active & (walls["observations"] >= LEAST_OBSERVATIONS))
    alike = overlaps(walls["frame"][rows], walls["low"][rows], walls["high"][rows])
    pairs = np.array([rows[[pair.first, pair.second]] for pair in alike], dtype=np.int64).reshape(-1, 2)
    found = []
    for pair, (first, second), joint in zip(alike, pairs.tolist(), graph.walls_covariances(pairs), strict=True):
        distance = pair.distance(_relative(joint, pair), flatness)
        if distance < GATE:
            found.append((distance, first, second))
    merged = 0
    for _, first, second in sorted(found):
        if walls["kept"][first] == first and walls["kept"][second] == second:
            landmarks.absorb(first, second)
            merged += 1
    return merged


def _relative(joint: Floats, pair: Overlap) -> Floats:
    """(2, 2): covariance of offset and turn between two walls in the middle of what they share, from their joint
    covariance (4, 4), each at its own frame."""
    jacobian = np.array([[-1.0, -pair.middle, 1.0, pair.middle - pair.along], [0.0, -1.0, 0.0, 1.0]])
    return np.asarray(jacobian @ joint @ jacobian.T)

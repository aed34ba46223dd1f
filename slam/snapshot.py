"""The map as plain data, copied out of the estimate."""

from __future__ import annotations

import numpy as np

from .events import MapCorners, MapLines
from .graph import FactorGraph
from .landmarks import Landmarks


def map_lines(landmarks: Landmarks, graph: FactorGraph, *, covariances: bool) -> MapLines:
    """The confirmed walls; with the covariances of their marginals if asked for, which takes about a millisecond each."""
    rows = landmarks.walls.rows
    chosen = np.flatnonzero(rows["in_graph"] & (rows["kept"] == np.arange(len(rows))))
    covariance = np.full((len(chosen), 2, 2), np.nan)
    if covariances:
        for row, wall in enumerate(chosen):
            covariance[row] = graph.wall_covariance(int(wall))
    walls = rows[chosen]
    return MapLines(
        identity=chosen,
        frame=walls["frame"].copy(),
        low=walls["low"].copy(),
        high=walls["high"].copy(),
        observations=walls["observations"].copy(),
        covariance=covariance,
    )


def map_corners(landmarks: Landmarks, graph: FactorGraph, *, covariances: bool) -> MapCorners:
    """The confirmed corners, likewise."""
    rows = landmarks.corners.rows
    chosen = np.flatnonzero(rows["in_graph"])
    covariance = np.full((len(chosen), 2, 2), np.nan)
    if covariances:
        for row, corner in enumerate(chosen):
            covariance[row] = graph.corner_covariance(int(corner))
    corners = rows[chosen]
    kept = landmarks.walls.rows["kept"]
    walls = corners["walls"]
    return MapCorners(
        identity=chosen,
        position=corners["position"].copy(),
        covariance=covariance,
        lines=np.where(walls >= 0, kept[walls] if len(kept) else walls, -1),
        observations=corners["observations"].copy(),
    )

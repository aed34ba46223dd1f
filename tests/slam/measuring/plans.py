"""Maps of walls drawn by hand, for tests of measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers import se2
from slam.geometry.segments import Floats
from slam.mapping.map_features import MapCorners, MapWalls
from slam.measuring.wall_map import WallMap

Point = tuple[float, float]
INSIDE = ((1.0, 1.0), (2.0, 1.5))
"""A path in the rooms of the tests."""


def wall_map(
    walls: Sequence[Sequence[Point]],
    corners: Sequence[tuple[int, int]] = (),
    path: Sequence[Point] = INSIDE,
    covariance: Floats | None = None,
) -> WallMap:
    """Return a map. Each wall is its pieces' ends, in the direction of its frame, in the middle of which this is.

    corners  pairs of walls that meet: the first one ends where the second one begins
    """
    frames, lows, highs, pieces = [], [], [], []
    for points in np.array([[*wall[:1], *wall[-1:]] for wall in walls], dtype=np.float64):
        along = points[1] - points[0]
        frames.append([*points.mean(axis=0), np.arctan2(along[1], along[0])])
        highs.append(0.5 * np.hypot(*along))
        lows.append(-highs[-1])
    for frame, wall in zip(frames, walls, strict=True):
        local = se2.transform(se2.inverse(frame), np.array(wall, dtype=np.float64)).reshape(-1, 2)
        pieces.append(local[:, 0].reshape(-1, 2))
    count = len(walls)
    joint = np.diag(np.tile([1e-6, 1e-8], count)) if covariance is None else covariance
    blocks = np.array([joint[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(count)])
    map_walls = MapWalls(
        10 + np.arange(count),
        np.array(frames),
        np.array(lows),
        np.array(highs),
        np.full(count, 5),
        blocks,
        tuple(pieces),
    )
    bare = MapCorners(np.arange(0), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.arange(0))
    result = WallMap(map_walls, bare, joint, np.array(path, dtype=np.float64))
    positions = np.array([result.intersection(*pair)[0] for pair in corners]).reshape(-1, 2)
    number = len(corners)
    known = MapCorners(
        np.arange(number),
        positions,
        np.tile(1e-6 * np.eye(2), (number, 1, 1)),
        10 + np.array(corners, dtype=np.int64).reshape(-1, 2),
        np.full(number, 5),
    )
    return replace(result, corners=known)


def room(corners: Sequence[Point]) -> list[list[Point]]:
    """Return the walls of a polygon, in its order: counter-clockwise is a room, clockwise an island."""
    return [[start, end] for start, end in zip(corners, [*corners[1:], corners[0]], strict=True)]


def around(count: int, first: int = 0) -> list[tuple[int, int]]:
    """Return the corners of a polygon of some walls."""
    return [(first + k, first + (k + 1) % count) for k in range(count)]


def moved(plan: WallMap, change: Floats) -> WallMap:
    """Return the map with all walls moved across and turned by a change (2 n,)."""
    shift = np.column_stack([np.zeros(len(plan.walls)), change.reshape(-1, 2)])
    return replace(plan, walls=replace(plan.walls, frame=se2.compose(plan.walls.frame, shift)))

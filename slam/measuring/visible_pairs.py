"""Pairs of parallel walls with nothing in between: widths of rooms and corridors, and thicknesses of walls."""

from __future__ import annotations

import numpy as np

from ..geometry.segments import Floats, Integers
from .measurement import Kind, Measurement, are_parallel, measure_distance
from .wall_map import WallMap

# Metres between the places along a wall from which other walls are looked for. Origin: chosen, the length of the cells
# that a wall's coverage consists of.
SAMPLE_SPACING = 0.1
# Metres along which two walls must be next to each other. Origin: chosen, as MIN_GAP_BETWEEN_PIECES; not measured.
MIN_SHARED = 0.5
# Metres before or behind a wall at which the search begins: a door frame or a ledge of the same wall is nearer.
# Origin: chosen, as MAX_DEPTH of the suppression of overlapping walls.
MIN_DISTANCE = 0.05


def measure_pairs(wall_map: WallMap) -> list[Measurement]:
    """Measure all widths and thicknesses, in the middle of what is opposite; ordered by kind and wall."""
    ends, piece_wall = wall_map.walls.piece_points()
    found: list[Measurement] = []
    for kind, sign in ((Kind.WIDTH, 1.0), (Kind.THICKNESS, -1.0)):
        for row in range(len(wall_map.walls)):
            samples = _samples(wall_map.walls.pieces[row])
            hit = _first_walls(wall_map, row, samples, sign, ends, piece_wall)
            for other in np.unique(hit[hit > row]).tolist():
                along = samples[hit == other]
                opposite = float(wall_map.normal(row) @ wall_map.normal(other)) < 0.0
                long_enough = len(along) * SAMPLE_SPACING >= MIN_SHARED
                if opposite and long_enough and are_parallel(wall_map, row, other):
                    found.append(measure_distance(wall_map, row, other, kind, float(np.median(along))))
    return found


def _samples(pieces: Floats) -> Floats:
    """Return places along the pieces (k, 2) of a wall, metres from its frame."""
    counts = np.maximum(np.round((pieces[:, 1] - pieces[:, 0]) / SAMPLE_SPACING), 1).astype(int)
    parts = [low + (high - low) * (np.arange(n) + 0.5) / n for (low, high), n in zip(pieces, counts, strict=True)]
    return np.concatenate(parts)


def _first_walls(
    wall_map: WallMap,
    row: int,
    samples: Floats,
    sign: float,
    ends: Floats,
    piece_wall: Integers,
) -> Integers:
    """Return the first wall (k,) that rays from places (k,) along a wall meet, -1 for none.

    sign        1 for rays from the side that the wall is seen from, -1 for rays into the wall
    ends        (p, 2, 2) of all pieces
    piece_wall  (p,) rows of their walls
    """
    x, y, heading = wall_map.walls.frame[row]
    c, s = np.cos(heading), np.sin(heading)
    offset = ends - np.array([x, y])
    along = c * offset[..., 0] + s * offset[..., 1]
    ahead = sign * (c * offset[..., 1] - s * offset[..., 0])
    span = along[:, 1] - along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (samples[:, None] - along[None, :, 0]) / span
        depth = ahead[:, 0] + share * (ahead[:, 1] - ahead[:, 0])
    depth = np.where((share >= 0.0) & (share <= 1.0) & (depth > MIN_DISTANCE), depth, np.inf)
    nearest = depth.argmin(axis=1)
    return np.where(np.isfinite(depth[np.arange(len(samples)), nearest]), piece_wall[nearest], -1)

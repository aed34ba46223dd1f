"""Synthetic scan points and distance fields for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from slam.geometry.segments import Floats, Segments
from slam.matching.distance_field import SEEN_CELLS, DistanceField
from slam.matching.offset_tiles import TILE
from slam.matching.point_matcher import POINT_SPACING
from slam.matching.scan_points import surface_points

SPACING = 0.005  # metres between neighbouring points
NOISE = 0.01  # metres, of a scan's points
FIELD_SCANS = 4  # in a field, from each pose
BEAMS = 720  # of a scan over a full turn
NO_SEGMENTS = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))


def outline(corners: Sequence[tuple[float, float]]) -> Floats:
    """Return points (n, 2) every half centimetre along the sides of a polygon with these corners, metres."""
    ends = np.array(corners, dtype=np.float64)
    sides = zip(ends, np.roll(ends, -1, axis=0), strict=True)
    return np.concatenate([np.linspace(a, b, int(np.hypot(*(b - a)) / SPACING)) for a, b in sides])


def with_noise(points: Floats, random: np.random.Generator) -> Floats:
    """Return points (n, 2) as a lidar measures them."""
    return points + random.normal(0.0, NOISE, points.shape)


def visible(points: Floats, pose: se2.Pose) -> Floats:
    """Return those of points (n, 2) in the map that a lidar at a pose sees: (p, 2) in its frame, by increasing angle.

    Each beam sees the nearest of the points in its direction.
    """
    local = se2.transform(se2.inverse(pose), points).reshape(-1, 2)
    beam = np.floor(BEAMS * (np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi))).astype(int)
    order = np.lexsort([np.hypot(local[:, 0], local[:, 1]), beam])
    return np.asarray(local[order[np.unique(beam[order], return_index=True)[1]]])


def scan_points(points: Floats, pose: se2.Pose, seed: int = 0, segments: Segments = NO_SEGMENTS) -> Floats:
    """Return (q, 4) what a scan from a pose shows of points (n, 2) in the map, with noise and normals."""
    seen = with_noise(visible(points, pose), np.random.default_rng(seed))
    return surface_points(seen, segments, POINT_SPACING)


def noisy_field(points: Floats, *poses: se2.Pose, half_width: float = 8.0, seed: int = 0) -> DistanceField:
    """Return the field of some scans of points (n, 2) in the map from each of the poses."""
    field = DistanceField.empty(poses[0][:2], half_width)
    for k in range(FIELD_SCANS):
        for i, pose in enumerate(poses):
            field.insert(pose, scan_points(points, pose, seed + 1000 * k + i))
    return field


def offsets_of(field: DistanceField) -> NDArray[np.int64]:
    """Return the stored offsets (5, c, c, 2) of all cells of a field, in units of OFFSET_UNIT."""
    grids, side, _ = field.offsets.tile_of.shape
    stored = field.offsets.tiles[field.offsets.tile_of].transpose(0, 1, 3, 2, 4).reshape(grids, side * TILE, -1)
    cells = SEEN_CELLS * len(field.seen)
    return np.stack([stored >> 16, (stored << 16) >> 16], axis=-1)[:, :cells, :cells].astype(np.int64)

"""Compute the arrays that are drawn from the estimate; independent of Rerun.

Everything lies near z = 0, at heights a few millimetres apart, so that the view from above is metric and the more
important things are drawn over the less important ones.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers import se2

from ...geometry.segments import Floats, Integers, Segments
from ...mapping.map_features import MapCorners, MapWalls

Float32s = NDArray[np.float32]

SIGMAS = 3.0  # standard deviations shown by ellipses and bands
ELLIPSE_HALF_THICKNESS = 5e-4  # metres; an ellipsoid must not be flat
DASHES = 9  # of a dashed line
ESTIMATE_STEPS = 1024.0  # rounding steps per metre of estimates, far below their sigmas; rounding makes files smaller
SCAN_STEPS = 256.0  # rounding steps per metre of scan points; a third smaller than unrounded
EMPTY_MAP_HALF_SIZE = 5.0  # metres shown around the origin before anything is mapped


class Height(float, Enum):
    """Heights of the drawn layers, metres, from the bottom to the top."""

    GRID = -0.010
    BACKDROP = -0.006
    ODOMETRY = -0.004
    SIGMA = -0.002
    CONFIDENCE = -0.001
    WALL = 0.0
    CORNER = 0.002
    ESTIMATE = 0.004
    KEYFRAME = 0.0045
    GROUND_TRUTH = 0.005  # thin, above the estimate: they should coincide
    FEATURE = 0.006
    LINK = 0.008
    SCAN = 0.010  # small dots above the segments, to show how well these fit
    LOOP = 0.012
    DECISION = 0.014


def to_3d(points: ArrayLike, height: Height, steps: float = ESTIMATE_STEPS) -> Float32s:
    """Return points (..., 2 or more) in metres as (..., 3) at a height, rounded to 1/`steps` of a metre."""
    flat = np.asarray(points, dtype=np.float64)[..., :2]
    lifted = np.empty((*flat.shape[:-1], 3), dtype=np.float32)
    lifted[..., :2] = np.round(flat * steps) / steps
    lifted[..., 2] = float(height)
    return lifted


def segment_ends(segments: Segments, pose: se2.Pose) -> Floats:
    """Return both ends (n, 2, 2) of each segment in the map, for the base at `pose`, metres."""
    frame = segments.frame.reshape(-1, 3)
    along = segments.half_length[:, None] * np.stack([np.cos(frame[:, 2]), np.sin(frame[:, 2])], axis=-1)
    ends = np.stack([frame[:, :2] - along, frame[:, :2] + along], axis=1)
    return se2.transform(pose, ends)


def ellipses(position: Floats, covariance: Floats, height: Height) -> tuple[Float32s, Float32s, Float32s]:
    """Return the 3-sigma ellipses of (m, 2) positions with (m, 2, 2) covariances, metres.

    Returns centres (k, 3), half sizes (k, 3) and quaternions xyzw (k, 4).
    Positions whose covariance is not finite are left out.
    """
    finite = np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(position).all(axis=1)
    variances, axes = np.linalg.eigh(covariance[finite])
    half_sizes = np.full((len(variances), 3), ELLIPSE_HALF_THICKNESS, dtype=np.float32)
    half_sizes[:, :2] = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    half_angle = 0.5 * np.arctan2(axes[:, 1, 0], axes[:, 0, 0])
    quaternions = np.zeros((len(variances), 4), dtype=np.float32)
    quaternions[:, 2], quaternions[:, 3] = np.sin(half_angle), np.cos(half_angle)
    return to_3d(position[finite], height), half_sizes, quaternions


def largest_sigmas(covariance: Floats) -> Floats:
    """Return the largest standard deviation (m,) in any direction of covariances (m, 2, 2); NaN if not finite."""
    finite = np.isfinite(covariance).all(axis=(1, 2))
    largest = np.full(len(covariance), np.nan)
    largest[finite] = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[finite])[:, -1], 0.0))
    return largest


def wall_bands(walls: MapWalls) -> Floats:
    """Return closed outlines (k, 5, 2) of the 3-sigma bands of the walls' offset along their length, metres.

    Walls whose covariance is not finite are left out.
    """
    finite = np.isfinite(walls.covariance).all(axis=(1, 2))
    frame, covariance = walls.frame[finite], walls.covariance[finite]
    x = np.stack([walls.low[finite], walls.high[finite]], axis=-1)
    offset, coupling, heading = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    variance = offset[:, None] + 2 * x * coupling[:, None] + x**2 * heading[:, None]
    y = SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    outline_x = np.stack([x[:, 0], x[:, 1], x[:, 1], x[:, 0], x[:, 0]], axis=-1)
    outline_y = np.stack([-y[:, 0], -y[:, 1], y[:, 1], y[:, 0], -y[:, 0]], axis=-1)
    return se2.transform(frame[:, None, :], np.stack([outline_x, outline_y], axis=-1))


def dashed(ends: Floats) -> Floats:
    """Return the dashes (k, 2, 2) of lines between ends (n, 2, 2); DASHES per line, whatever its length."""
    parts = (np.arange(DASHES)[:, None] + np.array([0.2, 0.8])) / DASHES
    along = ends[:, 1] - ends[:, 0]
    return np.asarray(ends[:, None, None, 0] + parts[None, :, :, None] * along[:, None, None]).reshape(-1, 2, 2)


def wall_links(centres: Floats, match: Integers, walls: MapWalls) -> Floats:
    """Return lines (k, 2, 2) from segment centres (n, 2) to their feet on the matched walls, metres.

    A long link reveals a wrong match. Centres without a match, or whose wall `walls` does not contain yet, are left
    out.
    """
    matched, rows = _rows_of(match, walls.identity)
    on_wall = se2.transform(se2.inverse(walls.frame[rows]), centres[matched])
    on_wall[:, 1] = 0.0
    return np.stack([centres[matched], se2.transform(walls.frame[rows], on_wall)], axis=1)


def corner_links(position: Floats, match: Integers, corners: MapCorners) -> Floats:
    """Return lines (k, 2, 2) from observed corners (n, 2) in the map to their matches, metres; as `wall_links`."""
    observed, matched = _rows_of(match, corners.identity)
    return np.stack([position[observed], corners.position[matched].reshape(-1, 2)], axis=1)


def _rows_of(match: Integers, identity: Integers) -> tuple[Integers, Integers]:
    """Return the indices of the features whose match is in `identity`, and the rows there."""
    row = {landmark_id: i for i, landmark_id in enumerate(identity.tolist())}
    pairs = [(i, row[wanted]) for i, wanted in enumerate(match.tolist()) if wanted in row]
    features, found = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return features, found


def bounds(*points: Floats) -> tuple[Floats, Floats]:
    """Return the lower and upper corner of the box around all finite points (..., 2), metres; 10 m without points."""
    stacked = np.concatenate([np.asarray(p, dtype=np.float64)[..., :2].reshape(-1, 2) for p in points])
    stacked = stacked[np.isfinite(stacked).all(axis=1)]
    if not len(stacked):
        return np.full(2, -EMPTY_MAP_HALF_SIZE), np.full(2, EMPTY_MAP_HALF_SIZE)
    return stacked.min(axis=0), stacked.max(axis=0)

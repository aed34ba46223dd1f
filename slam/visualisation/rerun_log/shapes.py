"""The estimate as the arrays that are drawn: plain geometry, nothing of Rerun.

Everything lies at z = 0 apart from layers a few millimetres apart, so that a view from above is metric and what matters
more is drawn over what matters less.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers import se2

from ...events import MapCorners, MapWalls
from ...geometry.segments import Floats, Integers, Segments

Drawn = NDArray[np.float32]

SIGMAS = 3.0
ELLIPSE_HALF_THICKNESS = 5e-4  # metres; an ellipsoid must not be flat
DASHES = 9  # of a dashed line
ROUND_ESTIMATE = 1024.0  # parts of a metre kept of what was estimated, far below its sigmas; rounding shrinks the file
ROUND_SCAN = 256.0  # parts of a metre kept of scan points; a third less than unrounded


class Layer(float, Enum):
    """Heights, metres, from the bottom to the top."""

    ODOMETRY = -0.004
    SIGMA = -0.002
    WALL = 0.0
    CORNER = 0.002
    ESTIMATE = 0.004
    KEYFRAME = 0.0045
    TRUTH = 0.005  # thin, over the estimate: they should coincide
    FEATURE = 0.006
    LINK = 0.008
    SCAN = 0.010  # small, over the segments: they show how well those fit
    LOOP = 0.012
    DECISION = 0.014


def lift(points: ArrayLike, layer: Layer, parts: float = ROUND_ESTIMATE) -> Drawn:
    """Points (..., 2 or more) in metres as (..., 3) at the layer's height, rounded to 1/`parts` of a metre."""
    flat = np.asarray(points, dtype=np.float64)[..., :2]
    lifted = np.empty((*flat.shape[:-1], 3), dtype=np.float32)
    lifted[..., :2] = np.round(flat * parts) / parts
    lifted[..., 2] = float(layer)
    return lifted


def segment_ends(segments: Segments, pose: se2.Pose) -> Floats:
    """(n, 2, 2): both ends of each segment in the map, for the base at `pose`, metres."""
    frame = segments.frame.reshape(-1, 3)
    along = segments.half_length[:, None] * np.stack([np.cos(frame[:, 2]), np.sin(frame[:, 2])], axis=-1)
    ends = np.stack([frame[:, :2] - along, frame[:, :2] + along], axis=1)
    return se2.transform(pose, ends)


def ellipses(position: Floats, covariance: Floats, layer: Layer) -> tuple[Drawn, Drawn, Drawn]:
    """The 3-sigma ellipses of (m, 2) positions with (m, 2, 2) covariances, metres.

    Returns centres (k, 3), half sizes (k, 3) and quaternions xyzw (k, 4).
    Those whose covariance is not finite are left out.
    """
    known = np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(position).all(axis=1)
    variances, axes = np.linalg.eigh(covariance[known])
    half_sizes = np.full((len(variances), 3), ELLIPSE_HALF_THICKNESS, dtype=np.float32)
    half_sizes[:, :2] = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    half_turn = 0.5 * np.arctan2(axes[:, 1, 0], axes[:, 0, 0])
    quaternions = np.zeros((len(variances), 4), dtype=np.float32)
    quaternions[:, 2], quaternions[:, 3] = np.sin(half_turn), np.cos(half_turn)
    return lift(position[known], layer), half_sizes, quaternions


def wall_bands(lines: MapWalls) -> Floats:
    """(k, 5, 2): closed outlines of where each wall may lie within 3 sigma of its offset at either end, metres.

    Walls whose covariance is not finite are left out.
    """
    known = np.isfinite(lines.covariance).all(axis=(1, 2))
    frame, covariance = lines.frame[known], lines.covariance[known]
    x = np.stack([lines.low[known], lines.high[known]], axis=-1)
    offset, coupling, turn = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    variance = offset[:, None] + 2 * x * coupling[:, None] + x**2 * turn[:, None]
    y = SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    outline_x = np.stack([x[:, 0], x[:, 1], x[:, 1], x[:, 0], x[:, 0]], axis=-1)
    outline_y = np.stack([-y[:, 0], -y[:, 1], y[:, 1], y[:, 0], -y[:, 0]], axis=-1)
    return se2.transform(frame[:, None, :], np.stack([outline_x, outline_y], axis=-1))


def dashed(ends: Floats) -> Floats:
    """(k, 2, 2): the dashes of lines between ends (n, 2, 2); always DASHES of them, so that long lines stay cheap."""
    parts = (np.arange(DASHES)[:, None] + np.array([0.2, 0.8])) / DASHES
    along = ends[:, 1] - ends[:, 0]
    return np.asarray(ends[:, None, None, 0] + parts[None, :, :, None] * along[:, None, None]).reshape(-1, 2, 2)


def wall_links(centres: Floats, match: Integers, lines: MapWalls) -> Floats:
    """(k, 2, 2): from each centre (n, 2) straight onto the wall it was matched with, metres; long where that is wrong.

    Centres without a match, or matched with a wall that `lines` does not hold yet, are left out.
    """
    seen, walls = _known(match, lines.identity)
    on_wall = se2.transform(se2.inverse(lines.frame[walls]), centres[seen])
    on_wall[:, 1] = 0.0
    return np.stack([centres[seen], se2.transform(lines.frame[walls], on_wall)], axis=1)


def corner_links(position: Floats, match: Integers, corners: MapCorners) -> Floats:
    """(k, 2, 2): from each corner seen, (n, 2) in the map, to the one it was matched with, metres; as `wall_links`."""
    seen, matched = _known(match, corners.identity)
    return np.stack([position[seen], corners.position[matched].reshape(-1, 2)], axis=1)


def _known(match: Integers, identity: Integers) -> tuple[Integers, Integers]:
    """The features whose match is among the identities, and where among them it is."""
    row = {known: i for i, known in enumerate(identity.tolist())}
    pairs = [(i, row[wanted]) for i, wanted in enumerate(match.tolist()) if wanted in row]
    seen, found = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return seen, found


def bounds(*points: Floats) -> tuple[Floats, Floats]:
    """The lower and the upper corner of the box around all finite points (..., 2), metres; 10 m where there is none."""
    stacked = np.concatenate([np.asarray(p, dtype=np.float64)[..., :2].reshape(-1, 2) for p in points])
    stacked = stacked[np.isfinite(stacked).all(axis=1)]
    if not len(stacked):
        return np.full(2, -5.0), np.full(2, 5.0)
    return stacked.min(axis=0), stacked.max(axis=0)

"""Intersection of two walls, with its derivative."""

from __future__ import annotations

import numpy as np

from drivers import se2

from .segments import Floats


def intersect_walls(first: se2.Pose, second: se2.Pose) -> tuple[Floats, Floats]:
    """Return the intersection (..., 2) of two walls, given their frames (..., 3), and its Jacobian (..., 2, 4) by
    offset and heading of both at their frames.

    A point p is on a wall with normal n through o if n . (p - o) = 0. Shifting the wall by y across itself and turning
    it by t moves its line at p by y + s t, with s the distance from o to p along the wall.
    """
    frames = np.stack([first, second], axis=-2)
    along = np.stack([np.cos(frames[..., 2]), np.sin(frames[..., 2])], axis=-1)
    inverse = np.linalg.inv(np.stack([-along[..., 1], along[..., 0]], axis=-1))
    offsets = along[..., 0] * frames[..., 1] - along[..., 1] * frames[..., 0]
    point = (inverse @ offsets[..., None])[..., 0]
    reach = (along * (point[..., None, :] - frames[..., :2])).sum(axis=-1)
    by_wall = np.swapaxes(inverse, -1, -2)  # its rows are the derivatives by the offsets
    jacobian = np.stack([by_wall, reach[..., None] * by_wall], axis=-2).reshape(*reach.shape[:-1], 4, 2)
    return point, np.swapaxes(jacobian, -1, -2)

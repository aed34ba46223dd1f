"""Intersection of two walls, with its derivative."""

from __future__ import annotations

import numpy as np

from drivers import se2

from .segments import Floats

# Sine of the angle between two walls below which their intersection is too uncertain to be a corner.
# Origin: chosen, 12 degrees; not measured.
MIN_SINE = 0.2


def intersect_walls(first: se2.Pose, second: se2.Pose) -> tuple[Floats, Floats]:
    """Return the intersection (2,) of two walls, and its Jacobian (2, 4) by offset and heading of both at their frames.

    A point p is on a wall with normal n through o if n . (p - o) = 0. Shifting the wall by y across itself and turning
    it by t moves its line at p by y + s t, with s the distance from o to p along the wall.
    """
    frames = np.stack([first, second])
    along = np.column_stack([np.cos(frames[:, 2]), np.sin(frames[:, 2])])
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    inverse = np.linalg.inv(normals)
    point = inverse @ np.einsum("ij,ij->i", normals, frames[:, :2])
    reach = np.einsum("ij,ij->i", along, point - frames[:, :2])
    jacobian = np.column_stack([inverse[:, 0], reach[0] * inverse[:, 0], inverse[:, 1], reach[1] * inverse[:, 1]])
    return point, jacobian

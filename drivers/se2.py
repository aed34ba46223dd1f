"""Rigid motions of the plane as arrays [x, y, heading] (metres, radians), alone or stacked as (..., 3).

`a` then `b` reads `compose(a, b)`: b is expressed in the frame that a places. T_map_base =
compose(T_map_odom, T_odom_base).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Pose = NDArray[np.float64]


def wrap(angle: ArrayLike) -> NDArray[np.float64]:
    """The same angle (radians, any shape) in [-pi, pi)."""
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi) % (2 * np.pi) - np.pi)


def compose(first: ArrayLike, second: ArrayLike) -> Pose:
    """The motion `first` followed by `second`, (..., 3); stacks broadcast."""
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack([x, y, wrap(a[..., 2] + b[..., 2])], axis=-1)


def inverse(pose: ArrayLike) -> Pose:
    """The motion that undoes `pose`, (..., 3)."""
    p = np.asarray(pose, dtype=np.float64)
    c, s = np.cos(p[..., 2]), np.sin(p[..., 2])
    return np.stack([-c * p[..., 0] - s * p[..., 1], s * p[..., 0] - c * p[..., 1], wrap(-p[..., 2])], axis=-1)


def between(first: ArrayLike, second: ArrayLike) -> Pose:
    """Where `second` stands as seen from `first`, (..., 3): compose(first, between(first, second)) is `second`."""
    return compose(inverse(first), second)


def transform(pose: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Points (..., 2) given in the frame that `pose` places, expressed in the frame that the pose is given in."""
    p, q = np.asarray(pose, dtype=np.float64), np.asarray(points, dtype=np.float64)
    c, s = np.cos(p[..., 2]), np.sin(p[..., 2])
    return np.stack([p[..., 0] + c * q[..., 0] - s * q[..., 1], p[..., 1] + s * q[..., 0] + c * q[..., 1]], axis=-1)


def adjoint(pose: ArrayLike) -> NDArray[np.float64]:
    """(3, 3): takes a small motion [x, y, heading] from the frame that `pose` places to the frame it is given in."""
    p = np.asarray(pose, dtype=np.float64)
    c, s = np.cos(p[2]), np.sin(p[2])
    return np.array([[c, -s, p[1]], [s, c, -p[0]], [0.0, 0.0, 1.0]])

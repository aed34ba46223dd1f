"""Rigid transforms in the plane, SE(2), as arrays [x, y, heading] (metres, radians), single or stacked (..., 3).

`compose(a, b)` is the product a b: T_map_base = compose(T_map_odom, T_odom_base).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Pose = NDArray[np.float64]
Angle = TypeVar("Angle", float, NDArray[np.float64])
# Radians: half a turn below which an arc is straight. Origin: numerical.
MIN_HALF_TURN = 1e-8


def wrap(angle: ArrayLike) -> NDArray[np.float64]:
    """Return the angle (radians, any shape) wrapped to [-pi, pi)."""
    if isinstance(angle, float):  # NumPy's float64 is one, too
        return np.asarray(_wrapped(float(angle)))
    return np.asarray(_wrapped(np.asarray(angle, dtype=np.float64)))


def compose(first: ArrayLike, second: ArrayLike) -> Pose:
    """Return the product of two transforms, (..., 3): `second` is given in the frame of `first`. Stacks broadcast."""
    a, b = np.asarray(first), np.asarray(second)
    if a.ndim == b.ndim == 1:
        return np.array(_product(a.tolist(), b.tolist()))
    a, b = a.astype(np.float64, copy=False), b.astype(np.float64, copy=False)
    heading = a[..., 2]
    c, s = _cosine_and_sine(heading)
    bx, by = b[..., 0], b[..., 1]
    return _stack_last(a[..., 0] + c * bx - s * by, a[..., 1] + s * bx + c * by, _wrapped(heading + b[..., 2]))


def inverse(pose: ArrayLike) -> Pose:
    """Return the inverse transform, (..., 3)."""
    p = np.asarray(pose, dtype=np.float64)
    if p.ndim == 1:
        return np.array(_inverse(p.tolist()))
    x, y, heading = p[..., 0], p[..., 1], p[..., 2]
    c, s = _cosine_and_sine(heading)
    return _stack_last(-c * x - s * y, s * x - c * y, _wrapped(-heading))


def between(first: ArrayLike, second: ArrayLike) -> Pose:
    """Return `second` relative to `first`, (..., 3): compose(first, between(first, second)) is `second`."""
    a, b = np.asarray(first), np.asarray(second)
    if a.ndim == b.ndim == 1:
        return np.array(_product(_inverse(a.tolist()), b.tolist()))
    return compose(inverse(a), b)


def transform(pose: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Transform points (..., 2) from the frame of `pose` to the frame in which `pose` is given."""
    p, q = np.asarray(pose, dtype=np.float64), np.asarray(points, dtype=np.float64)
    c, s = _cosine_and_sine(p[..., 2])
    x, y = q[..., 0], q[..., 1]
    return _stack_last(p[..., 0] + c * x - s * y, p[..., 1] + s * x + c * y)


def adjoint(pose: ArrayLike) -> NDArray[np.float64]:
    """Return the adjoint (..., 3, 3): it takes a small motion [x, y, heading] from the frame of `pose` to the frame in
    which `pose` is given."""
    p = np.asarray(pose, dtype=np.float64)
    result = np.zeros((*p.shape, 3))
    c, s = _cosine_and_sine(p[..., 2])
    result[..., 0, 0] = result[..., 1, 1] = c
    result[..., 0, 1], result[..., 1, 0] = -s, s
    result[..., 0, 2], result[..., 1, 2] = p[..., 1], -p[..., 0]
    result[..., 2, 2] = 1.0
    return result


def log(pose: ArrayLike) -> NDArray[np.float64]:
    """Return the twist (..., 3) [x, y, heading] that moves by a transform if it is constant along the way.

    The error of a heading turns all that was driven since. As twists such errors lie on a line, as transforms on an
    arc: so squared Mahalanobis distances are those of twists, if the heading may err by more than some degrees.
    """
    p = np.asarray(pose, dtype=np.float64)
    half = 0.5 * p[..., 2]
    small = np.abs(half) < MIN_HALF_TURN
    along = np.where(small, 1.0, half / np.tan(np.where(small, 1.0, half)))
    x, y = p[..., 0], p[..., 1]
    return _stack_last(along * x + half * y, along * y - half * x, p[..., 2])


def exp(twist: ArrayLike) -> Pose:
    """Return the transform (..., 3) of a twist: the inverse of `log`."""
    t = np.asarray(twist, dtype=np.float64)
    half = 0.5 * t[..., 2]
    chord = np.sinc(half / math.pi)  # numpy's sinc(x) is sin(pi x) / (pi x)
    c, s = chord * np.cos(half), chord * np.sin(half)
    return _stack_last(c * t[..., 0] - s * t[..., 1], s * t[..., 0] + c * t[..., 1], _wrapped(t[..., 2]))


# The functions above are called a hundred times per scan, mostly with a single pose. Arithmetic with Python's numbers
# takes a fifth of the time of arithmetic with arrays of three elements, and gives the same results. Poses are converted
# to float64 only for arithmetic with arrays: `np.asarray` takes several times as long if a type is given.


def _product(first: Sequence[float], second: Sequence[float]) -> tuple[float, float, float]:
    x, y, heading = first
    c, s = math.cos(heading), math.sin(heading)
    return (
        x + c * second[0] - s * second[1],
        y + s * second[0] + c * second[1],
        (heading + second[2] + math.pi) % (2 * math.pi) - math.pi,
    )


def _inverse(pose: Sequence[float]) -> tuple[float, float, float]:
    x, y, heading = pose
    c, s = math.cos(heading), math.sin(heading)
    return -c * x - s * y, s * x - c * y, (-heading + math.pi) % (2 * math.pi) - math.pi


# np.stack, and trigonometry on zero-dimensional arrays, would take four times as long.


def _wrapped(angle: Angle) -> Angle:
    return (angle + math.pi) % (2 * math.pi) - math.pi


def _cosine_and_sine(heading: NDArray[np.float64]) -> tuple[NDArray[np.float64] | float, NDArray[np.float64] | float]:
    return (np.cos(heading), np.sin(heading)) if heading.ndim else (math.cos(heading), math.sin(heading))


def _stack_last(*parts: NDArray[np.float64]) -> NDArray[np.float64]:
    result = np.empty((*parts[0].shape, len(parts)))
    for k, part in enumerate(parts):
        result[..., k] = part
    return result

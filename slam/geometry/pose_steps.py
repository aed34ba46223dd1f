"""Differences between single poses, and steps of Gauss-Newton, in compiled code; elsewhere `drivers.se2` serves."""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled, inlined

from .angles import wrap_angle


@compiled
def pose_error(prediction, pose):  # type: ignore[no-untyped-def]
    """Return the difference (3,) of a pose from its prediction, the position in the pose's own axes."""
    return np.array(difference(prediction, pose))


@inlined
def difference(prediction, pose):  # type: ignore[no-untyped-def]
    """Return the elements of `pose_error`."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] - prediction[0], pose[1] - prediction[1]
    return c * x + s * y, -s * x + c * y, wrap_angle(pose[2] - prediction[2])


@inlined
def wrap_heading(pose):  # type: ignore[no-untyped-def]
    """Wrap the heading of a pose in place, bit-equal to `drivers.se2.wrap`, unlike `wrap_angle`."""
    pose[2] = (pose[2] + math.pi) % (2 * math.pi) - math.pi


@inlined
def move_back(pose, move):  # type: ignore[no-untyped-def]
    """Move a pose in place against a step (3,) along its own axes."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0] -= c * move[0] - s * move[1]
    pose[1] -= s * move[0] + c * move[1]
    pose[2] -= move[2]

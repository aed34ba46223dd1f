"""Degenerate directions: those in which the features do not determine the position, e.g. along a bare corridor."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from .segments import Floats

# Information (per square metre and square radian) added in all directions, so that its inverse exists: corresponds to
# a standard deviation of 1 km. Origin: numerical.
_MIN_INFORMATION = 1e-6 * np.eye(3)


def weakest_direction(pose: se2.Pose, information: Floats, sigma: float) -> float | None:
    """Return the direction in the map, in [0, pi) radians, in which the position is least certain.

    None if its standard deviation is at most `sigma` metres in every direction. `information` (3, 3) is that of the
    pose, in its own frame.
    """
    covariance = np.linalg.inv(information + _MIN_INFORMATION)[:2, :2]
    if covariance[0, 0] + covariance[1, 1] <= sigma**2:  # the sum of both variances
        return None
    variances, directions = np.linalg.eigh(covariance)
    if variances[-1] <= sigma**2:
        return None
    return float((pose[2] + math.atan2(directions[1, -1], directions[0, -1])) % math.pi)

"""Degenerate directions: those in which the features do not determine the position, e.g. along a bare corridor."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from .segments import Floats
from .small_matrices import inverse

# Information (per square metre and square radian) added in all directions, so that its inverse exists: corresponds to
# a standard deviation of 1 km. Origin: numerical.
_MIN_INFORMATION = 1e-6 * np.eye(3)


def weakest_direction(pose: se2.Pose, information: Floats, sigma: float) -> float | None:
    """Return the direction in the map, in [0, pi) radians, in which the position is least certain.

    None if its standard deviation is at most `sigma` metres in every direction. `information` (3, 3) is that of the
    pose, in its own frame.
    """
    (xx, xy, _), (_, yy, _), _ = inverse(information + _MIN_INFORMATION).tolist()
    half_difference, middle = math.hypot(0.5 * (xx - yy), xy), 0.5 * (xx + yy)
    if middle + half_difference <= sigma**2:  # the larger of the variances along the principal axes
        return None
    return float((pose[2] + 0.5 * math.atan2(2.0 * xy, xx - yy)) % math.pi)

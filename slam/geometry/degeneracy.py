"""Degenerate directions: those in which the features do not determine the position, e.g. along a bare corridor."""

from __future__ import annotations

import math

from drivers import se2

from .segments import Floats

# Information (per square metre and square radian) added in all directions, so that it can be inverted: corresponds to
# a standard deviation of 1 km, far below the information of a single point. Origin: numerical.
MIN_INFORMATION = 1e-6


def weakest_direction(pose: se2.Pose, information: Floats, sigma: float) -> float | None:
    """Return the direction in the map, in [0, pi) radians, in which the position is least certain.

    None if its standard deviation is at most `sigma` metres in every direction. `information` (3, 3) is that of the
    pose, in its own frame.
    """
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = information.tolist()
    tt += MIN_INFORMATION  # of the position alone, if the heading is not known: the Schur complement
    xx, xy, yy = xx - xt * xt / tt, xy - xt * yt / tt, yy - yt * yt / tt
    least = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)  # the smaller eigenvalue; rounding may make it negative
    if least + MIN_INFORMATION >= sigma**-2:
        return None
    return float((pose[2] + 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi) % math.pi)

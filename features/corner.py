"""Corner of two lines, eqs. (36)-(38)."""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled
from .corner_angle import MIN_SINE
from .line_fit import LineFit
from .types import Floats


@compiled
def intersect(
    u1: float, v1: float, first: Floats, u2: float, v2: float, second: Floats
) -> tuple[float, float, float, float, float]:
    """Return (x, y, Cxx, Cxy, Cyy) of the intersection of two lines; NaN if they are parallel.

    `first` and `second` are the covariances (2, 2) of their (u, v).

    Equations (36)-(37) with x_Q = u and y_Q = -v. dp/d(u_k, v_k) = -m_k p', so that eq. (38) for independent lines is
    (p' C1 p) m1 m1' + (p' C2 p) m2 m2' with m1 = (v2, -u2) / det and m2 = (-v1, u1) / det.
    """
    determinant = u1 * v2 - u2 * v1
    if determinant == 0.0:
        return math.nan, math.nan, math.nan, math.nan, math.nan
    x, y = (v2 - v1) / determinant, (u1 - u2) / determinant
    g1 = x * x * first[0, 0] + 2.0 * x * y * first[0, 1] + y * y * first[1, 1]
    g2 = x * x * second[0, 0] + 2.0 * x * y * second[0, 1] + y * y * second[1, 1]
    scale = 1.0 / (determinant * determinant)
    return (
        x,
        y,
        scale * (g1 * v2 * v2 + g2 * v1 * v1),
        -scale * (g1 * u2 * v2 + g2 * u1 * v1),
        scale * (g1 * u2 * u2 + g2 * u1 * u1),
    )


def corner(first: LineFit, second: LineFit) -> tuple[Floats, Floats]:
    """Return position (2,) in metres and covariance (2, 2) of the corner of two lines fitted to different rays."""
    (u1, v1), (u2, v2) = first.uv, second.uv
    x, y, cxx, cxy, cyy = intersect(u1, v1, first.covariance, u2, v2, second.covariance)
    return np.array([x, y]), np.array([[cxx, cxy], [cxy, cyy]])


@compiled
def parallel(u1: float, v1: float, u2: float, v2: float) -> bool:
    """Return True if two lines are too close to parallel for a corner."""
    return not abs(u1 * v2 - u2 * v1) > MIN_SINE * math.sqrt((u1 * u1 + v1 * v1) * (u2 * u2 + v2 * v2))

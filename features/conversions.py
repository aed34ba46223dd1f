"""Conversions between a line's (u, v) and other parametrisations, with Jacobians, for display and comparison.

Covariances are stored in (u, v): the noise of a short or distant wall is Gaussian there, but not in (d, alpha).
"""

from __future__ import annotations

import math

import numpy as np

from .types import Floats


def covariance_through(jacobian: Floats, covariance: Floats) -> Floats:
    """Return the covariance (m, m) propagated through a Jacobian (m, n) from arguments with covariance (n, n)."""
    return np.asarray(jacobian @ covariance @ jacobian.T)


def polar_of_uv(uv: Floats) -> tuple[Floats, Floats]:
    """Return (d, alpha), distance in metres and bearing of the normal in radians, and the Jacobian (2, 2) in (u, v)."""
    u, v = uv
    d, alpha = 1.0 / math.hypot(u, v), math.atan2(v, u)
    c, s = math.cos(alpha), math.sin(alpha)
    return np.array([d, alpha]), np.array([[-d * d * c, -d * d * s], [-d * s, d * c]])


def uv_of_polar(polar: Floats) -> tuple[Floats, Floats]:
    """Return (u, v) of the line x cos(alpha) + y sin(alpha) = d, and the Jacobian (2, 2) in (d, alpha)."""
    d, alpha = polar
    c, s = math.cos(alpha), math.sin(alpha)
    return np.array([c, s]) / d, np.array([[-c / d, -s], [-s / d, c]]) / d


def uv_of_implicit(abc: Floats) -> tuple[Floats, Floats]:
    """Return (u, v) of the line a x + b y + c = 0, and the Jacobian (2, 3) in (a, b, c)."""
    a, b, c = abc
    return np.array([-a, -b]) / c, np.array([[-1.0, 0.0, a / c], [0.0, -1.0, b / c]]) / c

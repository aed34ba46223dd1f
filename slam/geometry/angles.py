"""Angles for functions compiled with numba; elsewhere `drivers.se2.wrap` serves."""

from __future__ import annotations

import math

from drivers.compiled import compiled


@compiled
def wrap_angle(angle: float) -> float:
    """Return the same angle (radians) in [-pi, pi)."""
    return angle - 2 * math.pi * math.floor((angle + math.pi) / (2 * math.pi))

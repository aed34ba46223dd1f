"""Angles inside compiled functions."""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True)
def wrap_angle(angle: float) -> float:
    """The same angle (radians) in [-pi, pi)."""
    return angle - 2 * math.pi * math.floor((angle + math.pi) / (2 * math.pi))

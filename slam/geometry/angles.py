"""Angles for functions compiled with numba; elsewhere `drivers.se2.wrap` serves."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled


@compiled
def wrap_angle(angle: float) -> float:
    """Return the same angle (radians) in [-pi, pi)."""
    return angle - 2 * math.pi * math.floor((angle + math.pi) / (2 * math.pi))


@compiled
def axes_of(frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 2) the unit vectors along x of frames (n, 3) [x, y, heading]."""
    axes = np.empty((len(frames), 2))
    for j in range(len(frames)):
        axes[j, 0], axes[j, 1] = math.cos(frames[j, 2]), math.sin(frames[j, 2])
    return axes

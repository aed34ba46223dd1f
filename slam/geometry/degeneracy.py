"""Which directions the geometry of a place leaves open: along a bare corridor no wall says how far."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from .segments import Floats


def weakest_direction(pose: se2.Pose, information: Floats, sigma: float) -> float | None:
    """The direction in the map (radians, 0 to pi) along which the position is known worse than `sigma` (metres).

    `information` (3, 3) is that of a pose, in the pose's own frame. None where every direction is known.
    """
    covariance = np.linalg.inv(information + 1e-6 * np.eye(3))[:2, :2]
    variances, directions = np.linalg.eigh(covariance)
    if variances[-1] <= sigma**2:
        return None
    return float((pose[2] + math.atan2(directions[1, -1], directions[0, -1])) % math.pi)

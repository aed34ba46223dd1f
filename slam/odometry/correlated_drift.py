"""Errors that wheels make alike motion after motion, where nothing that was seen held the robot.

Wheels larger than believed are so all along a bare corridor: what they get wrong adds up with the way, not with its
root. The graph takes the errors of its motions for independent ones. To give each of them the variance that its share
in the sum would need makes a chain so soft that a corridor is torn wherever walls that are not quite straight pull at
it. So motions keep the variance of what is theirs alone, which holds the chain together, and what they share is added
to the covariances afterwards. Closed loops and places seen again do not take it away: it is an upper bound there.
"""

from __future__ import annotations

import numpy as np

from ..geometry.segments import Floats


def embed_position_covariance(position: Floats) -> Floats:
    """(3, 3): a covariance (2, 2) of position as one of a pose. What would be below zero in some direction is not."""
    values, vectors = np.linalg.eigh(position)
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return covariance


def rotate_covariance(covariance: Floats, angle: float) -> Floats:
    """(3, 3): the covariance of a pose [x, y, heading] after its axes were turned by an angle (radians)."""
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(rotation @ covariance @ rotation.T)

"""Covariances of correlated drift: odometry errors that neighbouring motions share while no feature corrects them.

Along a bare corridor, the error of a wrong wheel diameter is the same in every motion: it grows with the travelled
distance, not with its square root. The graph treats the errors of motions as independent. If each motion got the
variance that its share of the sum requires, the chain of motions would be so soft that slightly bent walls tear a
corridor apart. So the graph gets the variance of each motion's independent errors only, and the shared errors are
accumulated beside it and added to the covariances that it returns. While driving, the sum is an upper bound after loop
closures and at revisited places; in a finished map, `slam.mapping.drift_covariance` conditions it on these.
"""

from __future__ import annotations

import numpy as np

from ..geometry.segments import Floats


def embed_position_covariance(position: Floats) -> Floats:
    """Return (3, 3) the covariance of a pose whose position has the covariance (2, 2) and whose heading is certain.

    Negative eigenvalues are clamped to zero.
    """
    covariance = np.zeros((3, 3))
    if position.any():  # mostly it is zero
        values, vectors = np.linalg.eigh(position)
        covariance[:2, :2] = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return covariance


def rotate_covariance(covariance: Floats, angle: float) -> Floats:
    """Return (3, 3) R C R^T for the covariance C of a pose [x, y, heading], with R the rotation by an angle (radians).

    A heading rotates it from the pose's axes to the map's, its negative from the map's to the pose's.
    """
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(rotation @ covariance @ rotation.T)

"""Covariances of poses: propagation, and the distance of poses in standard deviations."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from .segments import Floats

# Metres, metres, radians: standard deviations of a tracked pose, relative to its keyframe.
# Origin: chosen; no measurement recorded.
POSE_SIGMAS = np.array([0.02, 0.02, math.radians(1.0)])


def covariance_after(covariance: Floats, motion: se2.Pose) -> Floats:
    """Transform the covariance (3, 3) of a pose, in its own frame, by a motion without error that follows it."""
    adjoint = se2.adjoint(se2.inverse(motion))
    return np.asarray(adjoint @ covariance @ adjoint.T)


def position_sigma(covariance: Floats) -> float:
    """Return the standard deviation (metres) of a position in its least certain direction.

    covariance  (3, 3) of the pose
    """
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))


def squared_distance(pose: se2.Pose, other: se2.Pose, covariance: Floats) -> float:
    """Return the squared Mahalanobis distance of a pose from another one: that of the twist between them.

    covariance  (3, 3) of the difference, in the frame of `pose`
    """
    error = se2.log(se2.between(pose, other))
    return float(error @ np.linalg.solve(covariance, error))

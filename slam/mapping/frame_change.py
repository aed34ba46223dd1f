"""Change of the frame of a whole map, for example to that of a plan in which it was recognised."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..graph.factors import Factor, FactorKind
from ..graph.rebuilding import RigidMotion, rebuild

if TYPE_CHECKING:
    from .mapper import Mapper


# Covariance (3, 3) of the first keyframe's pose from then on, in its own frame, metres and radians: the plan or the
# pins determine this pose. Origin: numerical, weak, and enough if one direction is undetermined.
FIRST_POSE_COVARIANCE = np.diag(np.array([1.0, 1.0, 0.3]) ** 2)


def change_frame(mapper: Mapper, motion: se2.Pose) -> None:
    """Move all keyframes and landmarks of a map by a `motion` [x, y, heading], and free the pose of its first keyframe.

    The covariances of the keyframes' poses are set to that of the last one: only differences of them are used, and they
    have their gauge in common.
    """
    priors = [f for f in mapper.graph.solver.factors.values() if f.kind is FactorKind.POSE_PRIOR]
    moved = [replace(f, measured=se2.compose(motion, f.measured)) for f in priors]
    moved = [replace(f, covariance=FIRST_POSE_COVARIANCE) if f.first == 0 else f for f in moved]
    landmarks = mapper.landmarks
    keyframes = np.arange(mapper.keyframe_count)
    walls, corners = np.arange(len(landmarks.walls)), np.arange(len(landmarks.corners))
    mapper.graph = rebuild(mapper.graph, RigidMotion(motion, keyframes, walls, corners), _is_pose_prior, moved)
    landmarks.move(walls, corners, motion)
    rows = landmarks.corners.rows
    for name in ("covariance", "covariance_in_map"):
        rows[name] = _rotated(rows[name], motion[2])
    mapper.correlated_drift = _rotated(mapper.correlated_drift, motion[2])
    mapper.read_back_all()
    mapper.equalise_covariances()


def _is_pose_prior(factor: Factor) -> bool:
    """Return True if a factor is the prior of a keyframe."""
    return factor.kind is FactorKind.POSE_PRIOR


def _rotated(covariances: Floats, angle: float) -> Floats:
    """Return covariances (n, 2, 2) of positions in axes that are turned by an angle (radians)."""
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s], [s, c]])
    return np.asarray(rotation @ covariances @ rotation.T)

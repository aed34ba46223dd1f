"""Covariances of landmarks relative to a keyframe, from the joint covariance of all of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats

# Factor that corrects the marginals of the graph for the robust kernel, which reduces the weight of correct
# observations, too: w = 1 / (1 + s / 8) for the squared error s, chi-square with 1 dof. The inverse of the
# weighted Hessian is 1 / E[w] = 1.105 times the covariance of plain least squares; the covariance of an M-estimator,
# E[w^2 s] / E[w + 2 s dw/ds]^2, is 1.034 times it. This is the latter divided by the former. It is applied to published
# covariances; data association uses those of the graph. Origin: chi-square, 1 dof, integrated with WALL_CAUCHY_SCALE.
ROBUST_COVARIANCE_SCALE = 0.936


class LandmarkCovariances(NamedTuple):
    """Covariances of k keyframes, of n walls and of m corners.

    poses            (k, 3, 3) of the keyframes' poses in the map, along the map's axes
    walls            (n, 2, 2) of offset and heading at the wall's frame, relative to the last keyframe
    corners          (m, 2, 2) of the position along the map's axes, relative to the last keyframe
    walls_in_map     (n, 2, 2) of offset and heading in the map, times ROBUST_COVARIANCE_SCALE
    corners_in_map   (m, 2, 2) of the position in the map, times ROBUST_COVARIANCE_SCALE
    """

    poses: Floats
    walls: Floats
    corners: Floats
    walls_in_map: Floats
    corners_in_map: Floats


def landmark_covariances(joint: Floats, poses: Floats, frames: Floats, positions: Floats) -> LandmarkCovariances:
    """Compute relative covariances from a joint one.

    joint      (d, d), d = 3 k + 3 n + 2 m, of the keyframes, the walls and the corners, in this order, in GTSAM's
               tangent spaces: poses and walls in their own frames, corners along the map's axes
    poses      (k, 3) [x, y, heading] of the keyframes
    frames     (n, 3) of the walls
    positions  (m, 2) of the corners
    """
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    rotations = np.zeros((len(poses), 3, 3))
    rotations[:, 0, 0] = rotations[:, 1, 1] = c
    rotations[:, 0, 1], rotations[:, 1, 0], rotations[:, 2, 2] = -s, s, 1.0
    of_poses = _blocks(joint, 3 * np.arange(len(poses)), 3)
    joint, pose = joint[3 * len(poses) - 3 :, 3 * len(poses) - 3 :], poses[-1]  # from the last keyframe on
    starts = np.cumsum([3, *(3 for _ in frames), *(2 for _ in positions)])
    wall_covariances = _relative(joint, starts[: len(frames)], 3, se2.adjoint(se2.between(frames, pose)))
    lever = positions - pose[:2]
    jacobian = np.zeros((len(positions), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -lever[:, 1], lever[:, 0]
    corner_covariances = _relative(joint, starts[len(frames) : -1], 2, jacobian @ rotations[-1])
    return LandmarkCovariances(
        rotations @ of_poses @ rotations.transpose(0, 2, 1),
        wall_covariances[:, 1:, 1:],
        corner_covariances,
        ROBUST_COVARIANCE_SCALE * _blocks(joint, starts[: len(frames)] + 1, 2),  # without the position along the wall
        ROBUST_COVARIANCE_SCALE * _blocks(joint, starts[len(frames) : -1], 2),
    )


def _relative(joint: Floats, starts: NDArray[np.signedinteger], size: int, jacobian: Floats) -> Floats:
    """Return the covariances (n, size, size) of landmarks relative to the pose whose covariance is joint[:3, :3].

    starts    (n,) first row of each landmark in the joint covariance
    jacobian  (n, size, 3) change of each landmark if it moves with the pose
    """
    rows = starts[:, None] + np.arange(size)
    own, cross = joint[:3, :3], joint[rows, :3] @ jacobian.transpose(0, 2, 1)
    return np.asarray(
        _blocks(joint, starts, size) + jacobian @ own @ jacobian.transpose(0, 2, 1) - cross - cross.transpose(0, 2, 1)
    )


def _blocks(joint: Floats, starts: NDArray[np.signedinteger], size: int) -> Floats:
    """Return the blocks (n, size, size) on the diagonal of a joint covariance that begin in some rows (n,)."""
    rows = starts[:, None] + np.arange(size)
    return np.asarray(joint[rows[:, :, None], rows[:, None, :]])

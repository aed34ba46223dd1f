"""Covariances of landmarks relative to a keyframe, from the joint covariance of all of them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drivers.compiled import compiled, inlined

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
    of_poses, walls, corners, walls_in_map, corners_in_map = _relative_to_last(
        np.ascontiguousarray(joint),  # GTSAM's are stored by columns: the function would be compiled again
        poses,
        frames,
        positions,
    )
    return LandmarkCovariances(
        of_poses, walls, corners, ROBUST_COVARIANCE_SCALE * walls_in_map, ROBUST_COVARIANCE_SCALE * corners_in_map
    )


@compiled
def _relative_to_last(joint, poses, frames, positions):  # type: ignore[no-untyped-def]
    """Return the arrays of `LandmarkCovariances`, not yet scaled.

    A landmark moves by J if the last pose moves. Its covariance relative to that pose is S + J P J' - C J' - J C', with
    those of the landmark, S, of the pose, P, and between them, C.
    """
    last, x, y = 3 * len(poses) - 3, poses[-1, 0], poses[-1, 1]
    of_poses = np.empty((len(poses), 3, 3))
    for k in range(len(poses)):
        rotation = _rotation(poses[k, 2])
        of_poses[k] = rotation @ joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3].copy() @ rotation.T
    own, rotation = joint[last : last + 3, last : last + 3].copy(), _rotation(poses[-1, 2])
    walls, walls_in_map = np.empty((len(frames), 2, 2)), np.empty((len(frames), 2, 2))
    for k in range(len(frames)):
        at = last + 3 + 3 * k
        c, s = math.cos(frames[k, 2]), math.sin(frames[k, 2])
        dx, dy = x - frames[k, 0], y - frames[k, 1]
        adjoint = _rotation(poses[-1, 2] - frames[k, 2])  # of the last pose in the wall's frame
        adjoint[0, 2], adjoint[1, 2] = c * dy - s * dx, -c * dx - s * dy
        walls[k] = _relative(joint, own, adjoint, last, at)[1:, 1:]
        walls_in_map[k] = joint[at + 1 : at + 3, at + 1 : at + 3]  # without the position along the wall
    corners, corners_in_map = np.empty((len(positions), 2, 2)), np.empty((len(positions), 2, 2))
    jacobian = np.zeros((2, 3))
    for k in range(len(positions)):
        at = last + 3 + 3 * len(frames) + 2 * k
        jacobian[:, :2] = rotation[:2, :2]
        jacobian[0, 2], jacobian[1, 2] = y - positions[k, 1], positions[k, 0] - x
        corners[k] = _relative(joint, own, jacobian, last, at)
        corners_in_map[k] = joint[at : at + 2, at : at + 2]
    return of_poses, walls, corners, walls_in_map, corners_in_map


@inlined
def _rotation(heading):  # type: ignore[no-untyped-def]
    """Return the rotation (3, 3) of small motions from a frame with a heading to the map's axes."""
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@inlined
def _relative(joint, own, jacobian, last, at):  # type: ignore[no-untyped-def]
    """Return the covariance (n, n) of a landmark relative to the last pose, see `_relative_to_last`.

    own       (3, 3) covariance of the pose
    jacobian  (n, 3) J
    last, at  first rows of the pose and of the landmark in the joint covariance
    """
    end = at + len(jacobian)
    cross = joint[at:end, last : last + 3].copy() @ jacobian.T
    return joint[at:end, at:end] + jacobian @ own @ jacobian.T - cross - cross.T

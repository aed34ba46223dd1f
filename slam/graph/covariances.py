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
    of_poses, jacobian = np.empty((len(poses), 3, 3)), np.zeros((3, 3))
    jacobian[2, 2] = 1.0
    for k in range(len(poses)):
        _rotate(jacobian, poses[k, 2])
        for row in range(3):
            for column in range(3):
                of_poses[k, row, column] = _product(jacobian, joint, 3 * k, row, column)
    walls, walls_in_map = np.empty((len(frames), 2, 2)), np.empty((len(frames), 2, 2))
    for k in range(len(frames)):
        _rotate(jacobian, poses[-1, 2] - frames[k, 2])  # the adjoint of the last pose in the wall's frame
        c, s = math.cos(frames[k, 2]), math.sin(frames[k, 2])
        dx, dy = x - frames[k, 0], y - frames[k, 1]
        jacobian[0, 2], jacobian[1, 2] = c * dy - s * dx, -c * dx - s * dy
        _relative(joint, jacobian, 1, last, last + 3 + 3 * k, walls[k], walls_in_map[k])  # not along the wall
    corners, corners_in_map = np.empty((len(positions), 2, 2)), np.empty((len(positions), 2, 2))
    _rotate(jacobian, poses[-1, 2])
    for k in range(len(positions)):
        jacobian[0, 2], jacobian[1, 2] = y - positions[k, 1], positions[k, 0] - x
        at = last + 3 + 3 * len(frames) + 2 * k
        _relative(joint, jacobian, 0, last, at, corners[k], corners_in_map[k])
    return of_poses, walls, corners, walls_in_map, corners_in_map


@inlined
def _rotate(jacobian, heading):  # type: ignore[no-untyped-def]
    """Set the upper left block (2, 2) of a Jacobian to the rotation by a heading."""
    c, s = math.cos(heading), math.sin(heading)
    jacobian[0, 0], jacobian[0, 1], jacobian[1, 0], jacobian[1, 1] = c, -s, s, c


@inlined
def _product(jacobian, joint, at, r, c):  # type: ignore[no-untyped-def]
    """Return the element (r, c) of J P J' with the covariance P of the pose that begins in row `at`."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += jacobian[r, i] * joint[at + i, at + j] * jacobian[c, j]
    return total


@inlined
def _relative(joint, jacobian, skipped, last, at, relative, in_map):  # type: ignore[no-untyped-def]
    """Compute the covariances (2, 2) of a landmark relative to the last pose, see `_relative_to_last`, and in the map.

    skipped   first rows of J and of the landmark that are left out
    last, at  first rows of the pose and of the landmark in the joint covariance
    """
    for r in range(2):
        for c in range(2):
            row, column = skipped + r, skipped + c
            cross = 0.0
            for i in range(3):
                cross += joint[at + row, last + i] * jacobian[column, i]
                cross += joint[at + column, last + i] * jacobian[row, i]
            in_map[r, c] = joint[at + row, at + column]
            relative[r, c] = in_map[r, c] + _product(jacobian, joint, last, row, column) - cross

"""Uncertainty of odometry's motion during a sweep, added to the covariances of the scan's segments and corners.

A sweep is corrected with odometry's motion. The random error of that motion is common to neighbouring beams, so it does
not average out over a wall. At a beam, S metres of travel from the middle of the sweep, it is like an error of the
robot's pose: the heading error is a random walk from the middle in both directions, with the variance q S, and that of
the position is proportional to S. Segments i and j share the covariance of these errors,

    K_ij = diag(t S_i S_j, t S_i S_j, q min(S_i, S_j))

where S_i S_j is negative, and the minimum zero, if they are on different sides of the middle.

Segments enter the estimate as independent, with the covariances D_i + a J_i K_ii J_i' instead: D_i is that of the
sensor noise and J_i the derivative by the pose. The factor a is chosen such that the covariance that this implies for
the robot's pose is that of the same estimate with the true K: with the information I_i of each segment and H their sum,

    a = tr(H^-1 sum_ij I_i K_ij I_j) / tr(H^-1 sum_i I_i K_ii I_i)

It is at least one: so large is the error of a single segment.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from drivers.compiled import compiled

from ..geometry.segments import CornerPoints, Floats, Segments
from ..odometry.error_model import OdometryModel
from .deskew import DeskewedScan

if TYPE_CHECKING:
    from features.types import Lines

# Iterations of the factor, which the information of the segments depends on. Origin: numerical, it changes by less than
# a hundredth after that.
ITERATIONS = 5
# Information of a pose that is added for conditioning: standard deviations of a kilometre. Origin: numerical.
CONDITIONING = 1e-6


def add_motion_uncertainty(
    segments: Segments, corners: CornerPoints, lines: Lines, scan: DeskewedScan, model: OdometryModel
) -> tuple[Segments, CornerPoints]:
    """Add odometry's uncertainty during the sweep to the covariances of segments and corners; see the module.

    segments, corners  of the scan, in the base's frame
    lines              from which the segments were made, in the same order
    """
    if not len(segments) or not scan.travel.any():
        return segments, corners
    travel = _travel_from_the_middle(lines, scan)
    translation, rotation = model.variances(np.ones(()))  # after one metre
    jacobians = _pose_jacobians(segments)
    inflation = _variance_inflation(segments.covariance, jacobians, travel, float(translation), float(rotation))
    of_position, of_heading = inflation * translation * travel**2, inflation * rotation * np.abs(travel)
    variances = np.column_stack([of_position, of_position, of_heading])
    covariance = segments.covariance + (jacobians * variances[:, None, :]) @ jacobians.transpose(0, 2, 1)
    shift, turn = (v[corners.segments].mean(axis=1)[:, None, None] for v in (of_position, of_heading))
    levers = np.column_stack([-corners.position[:, 1], corners.position[:, 0]])
    turning = turn * levers[:, :, None] * levers[:, None, :]
    return replace(segments, covariance=covariance), replace(
        corners, covariance=corners.covariance + shift * np.eye(2) + turning
    )


def _travel_from_the_middle(lines: Lines, scan: DeskewedScan) -> Floats:
    """Return (n,) the metres of travel of each line's middle beam from the middle of the sweep, negative before it."""
    beams = np.where(lines.last >= lines.first, (lines.first + lines.last) // 2, 0)
    return np.where(beams < int(np.argmin(scan.travel)), -1.0, 1.0) * scan.travel[beams]


def _pose_jacobians(segments: Segments) -> Floats:
    """Return (n, 2, 3) the derivatives of each segment's offset and heading by the motion of the base [x, y, heading].

    They have the opposite sign of those of the measurements; only their products are used.
    """
    jacobians = np.zeros((len(segments), 2, 3))
    jacobians[:, 0, 0], jacobians[:, 0, 1] = -np.sin(segments.frame[:, 2]), np.cos(segments.frame[:, 2])
    jacobians[:, 0, 2] = jacobians[:, 0, 1] * segments.frame[:, 0] - jacobians[:, 0, 0] * segments.frame[:, 1]
    jacobians[:, 1, 2] = 1.0
    return jacobians


@compiled
def _variance_inflation(covariances, jacobians, travel, translation, rotation):  # type: ignore[no-untyped-def]
    """Return the variance inflation factor a of the module's documentation.

    covariances  (n, 2, 2) of the segments without the motion
    jacobians    (n, 2, 3) by the pose
    travel       (n,) metres from the middle of the sweep, negative before it
    translation, rotation  variances of position and heading after one metre of travel
    """
    inflation, information = 1.0, np.zeros((len(travel), 3, 3))
    for _ in range(ITERATIONS):
        _set_information(information, covariances, jacobians, travel, inflation * translation, inflation * rotation)
        correlated, separate = _implied_by_motion(information, travel, translation, rotation)
        covariance = np.linalg.inv(information.sum(axis=0) + CONDITIONING * np.eye(3))
        implied = np.trace(covariance @ separate)
        if implied <= 0.0:
            return 1.0
        inflation = max(1.0, np.trace(covariance @ correlated) / implied)
    return inflation


@compiled
def _set_information(information, covariances, jacobians, travel, translation, rotation):  # type: ignore[no-untyped-def]
    """Set the information (n, 3, 3) of the pose from each segment, with the variances of the motion.

    In scalars, as products of small matrices take most of their time for allocating memory.
    """
    for i in range(len(travel)):
        own, x, y, lever = covariances[i], jacobians[i, 0, 0], jacobians[i, 0, 1], jacobians[i, 0, 2]
        position, heading = translation * travel[i] ** 2, rotation * abs(travel[i])
        across = own[0, 0] + position + heading * lever * lever
        both, turn = own[0, 1] + heading * lever, own[1, 1] + heading
        determinant = across * turn - both * both
        w_across, w_both, w_turn = turn / determinant, -both / determinant, across / determinant
        along = w_across * lever + w_both
        result = information[i]
        result[0, 0], result[0, 1], result[1, 1] = w_across * x * x, w_across * x * y, w_across * y * y
        result[0, 2], result[1, 2] = along * x, along * y
        result[2, 2] = w_across * lever * lever + 2.0 * w_both * lever + w_turn
        result[1, 0], result[2, 0], result[2, 1] = result[0, 1], result[0, 2], result[1, 2]


@compiled
def _implied_by_motion(information, travel, translation, rotation):  # type: ignore[no-untyped-def]
    """Return the sums (3, 3) over I_i K_ij I_j: for all pairs of segments, and for i = j only."""
    count = len(travel)
    correlated, separate, shifts, turns = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 2)), np.zeros(3)
    for i in range(count):
        turns[:] = 0.0
        for j in range(count):
            if travel[i] * travel[j] > 0.0:
                shared = rotation * min(abs(travel[i]), abs(travel[j]))
                for k in range(3):
                    turns[k] += shared * information[j, k, 2]
        for k in range(3):
            shifts[k, 0] += travel[i] * information[i, k, 0]
            shifts[k, 1] += travel[i] * information[i, k, 1]
            for m in range(3):
                correlated[k, m] += information[i, k, 2] * turns[m]
                separate[k, m] += rotation * abs(travel[i]) * information[i, k, 2] * information[i, m, 2]
                of_position = information[i, k, 0] * information[i, m, 0] + information[i, k, 1] * information[i, m, 1]
                separate[k, m] += translation * travel[i] ** 2 * of_position
    return correlated + translation * shifts @ shifts.T, separate

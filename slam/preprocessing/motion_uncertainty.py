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
    factor = _factor(segments.covariance, jacobians, travel, float(translation), float(rotation))
    of_position, of_heading = factor * translation * travel**2, factor * rotation * np.abs(travel)
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
def _factor(covariances, jacobians, travel, translation, rotation):  # type: ignore[no-untyped-def]
    """Return the factor a of the module's documentation.

    covariances  (n, 2, 2) of the segments without the motion
    jacobians    (n, 2, 3) by the pose
    travel       (n,) metres from the middle of the sweep, negative before it
    translation, rotation  variances of position and heading after one metre of travel
    """
    count, factor = len(travel), 1.0
    information = np.zeros((count, 3, 3))
    for _ in range(ITERATIONS):
        total = CONDITIONING * np.eye(3)
        for i in range(count):
            jacobian, own = jacobians[i], _shared(travel[i], travel[i], translation, rotation)
            noise = covariances[i] + factor * (jacobian * own) @ jacobian.T
            information[i] = jacobian.T @ np.linalg.inv(noise) @ jacobian
            total += information[i]
        correlated, separate = np.zeros((3, 3)), np.zeros((3, 3))
        for i in range(count):
            for j in range(count):
                term = (information[i] * _shared(travel[i], travel[j], translation, rotation)) @ information[j]
                correlated += term
                if i == j:
                    separate += term
        covariance = np.linalg.inv(total)
        implied = np.trace(covariance @ separate)
        if implied <= 0.0:
            return 1.0
        factor = max(1.0, np.trace(covariance @ correlated) / implied)
    return factor


@compiled
def _shared(travel, other, translation, rotation):  # type: ignore[no-untyped-def]
    """Return (3,) the diagonal of K for two beams, given their metres of travel from the middle of the sweep."""
    position = translation * travel * other
    heading = rotation * min(abs(travel), abs(other)) if travel * other > 0.0 else 0.0
    return np.array([position, position, heading])

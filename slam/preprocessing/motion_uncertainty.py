"""Uncertainty of odometry's motion during a sweep, added to the covariances of the scan's segments and corners.

A sweep is corrected with odometry's motion. The random error of that motion is common to neighbouring beams, so it does
not average out over a wall. At a beam, S metres of travel from the middle of the sweep and negative before it, it is
like an error of the robot's pose. The error of the heading is a random walk w with the variance q per metre in both
directions. The reference of the sweep is the middle of a parabola that is fitted to odometry from -l to l (see
`deskew`), so the middle of that fitted to w is subtracted. The error of the position is proportional to S. Segments i
and j share the covariance of these errors,

    K_ij = diag(t S_i S_j, t S_i S_j, q k_ij)
    k_ij = m_ij - c_i - c_j + 9/112 l
    c_i  = l (x / 2 - 9/16 x^2 + 5/32 x^4),  x = min(|S_i| / l, 1)

where m_ij, the covariance of w at both beams, is min(|S_i|, |S_j|) if they are on the same side of the middle, else
zero; c_i is that of w_i with the middle of the parabola, and 9/112 l is the variance of the latter.

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
from ..geometry.small_matrices import inverse
from ..odometry.error_model import PARABOLA_VARIANCE, OdometryModel
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
    headings = _heading_covariances(travel, scan.fitted)
    inflation = _variance_inflation(
        segments.covariance, jacobians, travel, headings, float(translation), float(rotation)
    )
    of_position, of_heading = inflation * translation * travel**2, inflation * rotation * np.diag(headings)
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
def _heading_covariances(travel, fitted):  # type: ignore[no-untyped-def]
    """Return (n, n) the covariances of the heading errors, divided by the variance per metre; see the module.

    travel  (n,) metres from the middle of the sweep, negative before it
    fitted  metres from there to either end of the interval that the reference is fitted to
    """
    count = len(travel)
    result, with_fit = np.empty((count, count)), np.zeros(count)
    for i in range(count):
        if fitted > 0.0:
            x = min(abs(travel[i]) / fitted, 1.0)
            with_fit[i] = fitted * (x / 2.0 - 9.0 / 16.0 * x**2 + 5.0 / 32.0 * x**4)
    for i in range(count):
        for j in range(count):
            shared = min(abs(travel[i]), abs(travel[j])) if travel[i] * travel[j] > 0.0 else 0.0
            result[i, j] = shared - with_fit[i] - with_fit[j] + PARABOLA_VARIANCE * fitted
    return result


@compiled
def _variance_inflation(covariances, jacobians, travel, headings, translation, rotation):  # type: ignore[no-untyped-def]
    """Return the variance inflation factor a of the module's documentation.

    covariances  (n, 2, 2) of the segments without the motion
    jacobians    (n, 2, 3) by the pose
    travel       (n,) metres from the middle of the sweep, negative before it
    headings     (n, n) covariances of the heading errors, in units of `rotation`
    translation, rotation  variances of position and heading after one metre of travel
    """
    inflation, information = 1.0, np.zeros((len(travel), 3, 3))
    own = np.diag(headings).copy()
    for _ in range(ITERATIONS):
        _set_information(
            information, covariances, jacobians, travel, own, inflation * translation, inflation * rotation
        )
        correlated, separate = _implied_by_motion(information, travel, headings, translation, rotation)
        covariance = inverse(information.sum(axis=0) + CONDITIONING * np.eye(3))
        implied = (covariance * separate).sum()  # the trace of the product, as both are symmetric
        if implied <= 0.0:
            return 1.0
        inflation = max(1.0, (covariance * correlated).sum() / implied)
    return inflation


@compiled
def _set_information(information, covariances, jacobians, travel, own_heading, translation, rotation):  # type: ignore[no-untyped-def]
    """Set the information (n, 3, 3) of the pose from each segment, with the variances of the motion.

    In scalars, as products of small matrices take most of their time for allocating memory.
    """
    for i in range(len(travel)):
        own, x, y, lever = covariances[i], jacobians[i, 0, 0], jacobians[i, 0, 1], jacobians[i, 0, 2]
        position, heading = translation * travel[i] ** 2, rotation * own_heading[i]
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
def _implied_by_motion(information, travel, headings, translation, rotation):  # type: ignore[no-untyped-def]
    """Return the sums (3, 3) over I_i K_ij I_j: for all pairs of segments, and for i = j only."""
    count = len(travel)
    correlated, separate, shifts, turns = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 2)), np.zeros(3)
    for i in range(count):
        turns[:] = 0.0
        for j in range(count):
            for k in range(3):
                turns[k] += rotation * headings[i, j] * information[j, k, 2]
        for k in range(3):
            shifts[k, 0] += travel[i] * information[i, k, 0]
            shifts[k, 1] += travel[i] * information[i, k, 1]
            for m in range(3):
                correlated[k, m] += information[i, k, 2] * turns[m]
                separate[k, m] += rotation * headings[i, i] * information[i, k, 2] * information[i, m, 2]
                of_position = information[i, k, 0] * information[i, m, 0] + information[i, k, 1] * information[i, m, 1]
                separate[k, m] += translation * travel[i] ** 2 * of_position
    for k in range(3):
        for m in range(3):
            correlated[k, m] += translation * (shifts[k, 0] * shifts[m, 0] + shifts[k, 1] * shifts[m, 1])
    return correlated, separate

"""Uncertainty of odometry's motion during a sweep, added to the covariances of the scan's segments and corners.

The changes of the segments by one standard deviation of each error are the responses R_i, see `sweep_responses`.

To a large part they move all segments together, as if the robot had been at another pose. The scan is a rigid body
then, and its walls fit those of other scans: that part must not make the walls uncertain. It is the displacement G
(3, m) of the scan. With the derivatives J_i (2, 3) of a segment by a displacement, the covariance D_i of the sensor
noise, what the displacement leaves of the responses, S_i, and the weights W_i of the segment in the estimate,

    S_i = R_i - J_i G,    W_i = (D_i + S_i S_i')^-1,    H = sum_i J_i' W_i J_i,    F = H^-1 sum_i J_i' W_i R_i

F is the displacement that the segments show. In directions that they hardly determine, such as along a corridor, it
follows how single walls are bent, with the covariance B. The displacement itself has at most that of the pose at the
ends of the sweep, P, so

    B = H^-1 (sum_i J_i' W_i S_i S_i' W_i J_i) H^-1,    G = P (P + B)^-1 F

Keyframes in the graph have the pose of the displaced scan, so segment i has the covariance D_i + S_i S_i'. The errors
that are left are correlated among the segments, but hardly move the pose together. The robot is at that pose with the
additional covariance G G', the sweep covariance, which counts where poses are published.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined
from drivers.small_matrices import inverse

from ..geometry.segments import CornerPoints, Floats, Segments
from ..odometry.error_model import OdometryModel
from .deskew import DeskewedScan
from .sweep_responses import segment_jacobians, segment_responses

if TYPE_CHECKING:
    from features.types import Lines, Noise

# Iterations of the displacement, on which its weights depend. Origin: numerical, it changes by less than a hundredth
# after that.
ITERATIONS = 5
# Share of the inverse of P that is added to H: a single wall does not determine a displacement along it. Origin:
# numerical, little beside the information of walls, and far more than rounding errors of it.
CONDITIONING = 1e-6


def add_motion_uncertainty(
    segments: Segments,
    corners: CornerPoints,
    lines: Lines,
    scan: DeskewedScan,
    model: OdometryModel,
    noise: Noise,
    mount: se2.Pose,
) -> tuple[Segments, CornerPoints, Floats]:
    """Add odometry's uncertainty during the sweep to the covariances of segments and corners; see the module.

    segments, corners  of the scan, in the base's frame
    lines              from which the segments were made, in the same order
    noise              of a ray, from which the weights of the fit follow
    mount              pose of the lidar in the base's frame
    Returns also the sweep covariance (3, 3), of the scan's displacement in the base's frame, metres and radians.
    """
    reach = scan.motion.reach
    if not len(segments) or not reach:
        return segments, corners, np.zeros((3, 3))
    responses = segment_responses(segments, lines, scan.bearings, scan.motion, model, noise, mount)
    translation, rotation = (float(variance) for variance in model.variances(np.array(reach)))
    limit = np.diag([translation, translation, rotation])
    left, displacement = _without_displacement(segments.covariance, segment_jacobians(segments), responses, limit)
    of_corners = _corner_covariances(segments.frame, corners.position, corners.segments, left)
    return (
        replace(segments, covariance=segments.covariance + left @ left.transpose(0, 2, 1)),
        replace(corners, covariance=corners.covariance + of_corners),
        displacement @ displacement.T,
    )


def displaced(segments: Segments, corners: CornerPoints, covariance: Floats) -> tuple[Segments, CornerPoints]:
    """Add the covariance (3, 3) of a displacement of the whole scan to those of its segments and corners."""
    jacobians = segment_jacobians(segments)
    of_corners = np.zeros((len(corners), 2, 3))
    of_corners[:, 0, 0] = of_corners[:, 1, 1] = 1.0
    of_corners[:, 0, 2], of_corners[:, 1, 2] = -corners.position[:, 1], corners.position[:, 0]
    return (
        replace(segments, covariance=segments.covariance + jacobians @ covariance @ jacobians.transpose(0, 2, 1)),
        replace(corners, covariance=corners.covariance + of_corners @ covariance @ of_corners.transpose(0, 2, 1)),
    )


@compiled
def _without_displacement(covariances, jacobians, responses, limit):  # type: ignore[no-untyped-def]
    """Return S (n, 2, m) and G (3, m) of the module's documentation.

    covariances  (n, 2, 2) D of the segments
    jacobians    (n, 2, 3) J by a displacement
    responses    (n, 2, m) R
    limit        (3, 3) P
    """
    left, displacement = responses.copy(), np.zeros((3, responses.shape[2]))
    for _ in range(ITERATIONS):
        information, bends = CONDITIONING * inverse(limit), np.zeros((3, 3))
        together = np.zeros_like(displacement)
        for i in range(len(covariances)):
            gain = _gain(covariances[i], left[i], jacobians[i])
            _add_product(information, gain, jacobians[i])
            _add_product(together, gain, responses[i])
            moved = _product(gain, left[i])
            _add_product(bends, moved, moved.T)
        covariance = inverse(information)
        of_bends = _product(_product(covariance, bends), covariance)
        shares = _product(limit, inverse(limit + of_bends))
        displacement = _product(shares, _product(covariance, together))
        left[:] = responses
        for i in range(len(covariances)):
            _add_product(left[i], -jacobians[i], displacement)
    return left, displacement


@compiled
def _product(first, second):  # type: ignore[no-untyped-def]
    """Return the product of two small matrices."""
    total = np.zeros((first.shape[0], second.shape[1]))
    _add_product(total, first, second)
    return total


@inlined
def _add_product(total, first, second):  # type: ignore[no-untyped-def]
    """Add the product of two small matrices to `total`."""
    for i in range(first.shape[0]):
        for j in range(first.shape[1]):
            factor = first[i, j]
            for m in range(second.shape[1]):
                total[i, m] += factor * second[j, m]


@compiled
def _gain(noise, left, jacobian):  # type: ignore[no-untyped-def]
    """Return J' W (3, 2) of a segment with the covariance D (2, 2), what is left of its responses S (2, m), and J."""
    of_offset, of_heading, both = noise[0, 0], noise[1, 1], noise[0, 1]
    for m in range(left.shape[1]):
        of_offset += left[0, m] * left[0, m]
        of_heading += left[1, m] * left[1, m]
        both += left[0, m] * left[1, m]
    determinant = of_offset * of_heading - both * both
    gain = np.empty((3, 2))
    for k in range(3):
        offset, heading = jacobian[0, k], jacobian[1, k]
        gain[k, 0] = (of_heading * offset - both * heading) / determinant
        gain[k, 1] = (of_offset * heading - both * offset) / determinant
    return gain


@compiled
def _corner_covariances(frames, positions, pairs, responses):  # type: ignore[no-untyped-def]
    """Return (c, 2, 2) the covariances of corners, where two lines intersect, by the responses (n, 2, m) of the lines.

    frames     (n, 3) of the segments
    positions  (c, 2) of the corners
    pairs      (c, 2) their segments
    """
    result = np.zeros((len(positions), 2, 2))
    for k in range(len(positions)):
        i, j = pairs[k]
        first_x, first_y, first_place = _line_at(frames[i], positions[k])
        second_x, second_y, second_place = _line_at(frames[j], positions[k])
        determinant = first_x * second_y - first_y * second_x
        for m in range(responses.shape[2]):
            first = (responses[i, 0, m] + first_place * responses[i, 1, m]) / determinant
            second = (responses[j, 0, m] + second_place * responses[j, 1, m]) / determinant
            x, y = second_y * first - first_y * second, first_x * second - second_x * first
            result[k, 0, 0] += x * x
            result[k, 0, 1] += x * y
            result[k, 1, 1] += y * y
        result[k, 1, 0] = result[k, 0, 1]
    return result


@compiled
def _line_at(frame, position):  # type: ignore[no-untyped-def]
    """Return the direction across a line, and the place on it, metres along from its middle, of a position on it."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    return -s, c, c * (position[0] - frame[0]) + s * (position[1] - frame[1])

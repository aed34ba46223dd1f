"""Uncertainty of odometry's motion during a sweep, added to the covariances of the scan's segments and corners.

A sweep is corrected with odometry's motion, whose random error is common to neighbouring beams: it does not average out
over a wall, and it bends the wall. At a beam, s metres of travel from the middle of the sweep and negative before it,
it is like an error of the robot's pose. The error of the position is s b with b ~ N(0, t I). That of the heading is a
random walk w, which grows between two readings, d metres apart, by N(0, q d), and evenly: the robot moves smoothly, and
the error is in the readings. The reference of the sweep is the middle of a parabola that is fitted to odometry from -l
to l seconds (see `deskew`), so the middle of that fitted to w is subtracted:

    e(u) = w(u) - int_-1^1 v(x) w(l x) dx,    v(x) = (9 - 15 x^2) / 8

Inexact stamps of the readings make the whole motion m = (x, y, h) since the middle too fast by the share c (see
`smoothed_poses`).

The offset d and the heading h of a segment are sums over the distances of its beams from the line, with the gains g_k
of the weighted fit. Beam k ends at p_k, x_k along the line from its middle. With the directions t along and n across
the line, the motion moves it across the line by e(u_k) t'p_k + s_k n'b + c (h_k t'p_k + n'[x_k, y_k]):

    [d, h] = sum_k g_k (...),    g_k = w_k N^-1 [1, x_k],    N = sum_k w_k [1, x_k] [1, x_k]'

This is linear in b, in c and in the steps of the random walk. Let the responses R_i (2, m) of segment i be its changes
by one standard deviation of each of these errors.

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

from ..geometry.line_segments import MIN_WALL_DISTANCE
from ..geometry.segments import CornerPoints, Floats, Segments
from ..geometry.small_matrices import inverse
from ..odometry.error_model import OdometryModel
from .deskew import DeskewedScan, SweepMotion

if TYPE_CHECKING:
    from features.types import Lines, Noise

# Iterations of the displacement, on which its weights depend. Origin: numerical, it changes by less than a hundredth
# after that.
ITERATIONS = 5
# Share of the inverse of P that is added to H: a single wall does not determine a displacement along it. Origin:
# numerical, little beside the information of walls, and far more than rounding errors of it.
CONDITIONING = 1e-6
# Sine of the least angle between a beam and a wall, and least determinant of the fit of a line, for conditioning.
# Origin: numerical.
MIN_SINE = 1e-6
SMALLEST = float(np.finfo(float).tiny)


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
    if not len(segments) or not scan.motion.reach:
        return segments, corners, np.zeros((3, 3))
    responses = _segment_responses(segments, lines, scan.bearings, scan.motion, model, noise, mount)
    translation, rotation = (float(variance) for variance in model.variances(np.array(scan.motion.reach)))
    limit = np.diag([translation, translation, rotation])
    left, displacement = _without_displacement(segments.covariance, _jacobians(segments), responses, limit)
    of_corners = _corner_covariances(segments.frame, corners.position, corners.segments, left)
    return (
        replace(segments, covariance=segments.covariance + left @ left.transpose(0, 2, 1)),
        replace(corners, covariance=corners.covariance + of_corners),
        displacement @ displacement.T,
    )


def displaced(segments: Segments, corners: CornerPoints, covariance: Floats) -> tuple[Segments, CornerPoints]:
    """Add the covariance (3, 3) of a displacement of the whole scan to those of its segments and corners."""
    jacobians = _jacobians(segments)
    of_corners = np.zeros((len(corners), 2, 3))
    of_corners[:, 0, 0] = of_corners[:, 1, 1] = 1.0
    of_corners[:, 0, 2], of_corners[:, 1, 2] = -corners.position[:, 1], corners.position[:, 0]
    return (
        replace(segments, covariance=segments.covariance + jacobians @ covariance @ jacobians.transpose(0, 2, 1)),
        replace(corners, covariance=corners.covariance + of_corners @ covariance @ of_corners.transpose(0, 2, 1)),
    )


def _segment_responses(
    segments: Segments,
    lines: Lines,
    bearings: Floats,
    motion: SweepMotion,
    model: OdometryModel,
    noise: Noise,
    mount: se2.Pose,
) -> Floats:
    """Return (n, 2, m + 4) the changes of offset and heading by one standard deviation of each error."""
    interval = np.clip(np.searchsorted(motion.nodes, motion.times, side="right") - 1, 0, len(motion.steps) - 1)
    part = (motion.times - motion.nodes[interval]) / np.diff(motion.nodes)[interval]
    turns, shifts, speeds = _unit_responses(
        segments.frame,
        segments.half_length,
        np.ascontiguousarray(lines.first),  # a column of one row is contiguous, and would be compiled for separately
        np.ascontiguousarray(lines.last),
        bearings,
        np.copysign(motion.travel, motion.times) + motion.offset,
        motion.poses,
        (interval, part, _shares_in_fit(motion.nodes, motion.fitted)),
        tuple(mount.tolist()),
        (noise.sigma_range**2, noise.sigma_bearing**2),
    )
    jacobians = _jacobians(segments)
    translation = float(model.variances(np.ones(()))[0])  # after one metre
    moved = math.sqrt(translation) * shifts[:, :, None] * jacobians[:, :1, :2]
    turned = math.sqrt(float(model.variances(np.array(motion.offset))[1])) * jacobians[:, :, 2:]
    sped = motion.speed_error * speeds[:, :, None]
    return np.concatenate([np.sqrt(model.variances(motion.steps)[1]) * turns, moved, turned, sped], axis=2)


def _shares_in_fit(nodes: Floats, fitted: float) -> Floats:
    """Return (m,) what the middle of the fitted parabola has of each step of the random walk, between two `nodes`.

    A step r rises from 0 to 1 between its nodes a and b. With V = int v, which is 0 before -1 and 1 after 1,

        int_-1^1 v(x) r(l x) dx = 1 - int_a^b V(u / l) du / (b - a)
    """
    x = nodes / fitted if fitted else np.copysign(np.inf, nodes)
    inner = np.clip(x, -1.0, 1.0)
    integral = np.where(
        np.abs(x) < 1.0, fitted * (3.0 + 16.0 * inner + 18.0 * inner**2 - 5.0 * inner**4) / 32.0, np.maximum(nodes, 0.0)
    )
    return np.asarray(1.0 - np.diff(integral) / np.diff(nodes))


@compiled
def _unit_responses(frames, half_lengths, first, last, bearings, travel, poses, walk, mount, variances):  # type: ignore[no-untyped-def]
    """Return the changes of offset and heading of each segment by a unit of each error.

    By each step of the heading (n, 2, m), radians, by the component n'b (n, 2) of the position, and by the relative
    error c (n, 2) of the speed. All beams from the `first` to the `last` one of a segment count as beams on it.

    frames     (n, 3) of the segments in the base's frame
    travel     (p,) metres from the middle of the sweep, negative before it
    poses      (p, 3) of the base
    walk       (p,) the step that each beam is in, (p,) how much of it is over, and (m,) the share of each step in the
               middle of the fitted parabola
    variances  of range and bearing of a ray
    """
    interval, part, of_fit = walk
    steps = len(of_fit)
    turns, shifts, speeds = np.zeros((len(frames), 2, steps)), np.zeros((len(frames), 2)), np.zeros((len(frames), 2))
    count = len(bearings)
    weights, places = np.empty(count), np.empty(count)
    for i in range(len(frames)):
        c, s = math.cos(frames[i, 2]), math.sin(frames[i, 2])
        lever = c * frames[i, 0] + s * frames[i, 1]
        beams, whole = (last[i] - first[i]) % count + 1, np.zeros((steps, 2))  # of beams by the step they are in
        total = one = two = 0.0
        for b in range(beams):
            bearing = bearings[(first[i] + b) % count]
            weights[b], places[b] = _weight_and_place(frames[i], half_lengths[i], bearing, mount, variances)
            total, one, two = total + weights[b], one + weights[b] * places[b], two + weights[b] * places[b] ** 2
        determinant = max(total * two - one * one, SMALLEST)
        for b in range(beams):
            beam, arm = (first[i] + b) % count, places[b] + lever
            offset = weights[b] * (two - one * places[b]) / determinant
            heading = weights[b] * (total * places[b] - one) / determinant
            shifts[i, 0] += offset * travel[beam]
            shifts[i, 1] += heading * travel[beam]
            moved = poses[beam, 2] * arm + c * poses[beam, 1] - s * poses[beam, 0]
            speeds[i, 0] += offset * moved
            speeds[i, 1] += heading * moved
            step = interval[beam]
            whole[step, 0] += offset * arm
            whole[step, 1] += heading * arm
            turns[i, 0, step] += part[beam] * offset * arm
            turns[i, 1, step] += part[beam] * heading * arm
        later_offset = later_heading = 0.0  # of the beams in later steps, which have all of this one
        for step in range(steps - 1, -1, -1):
            turns[i, 0, step] += later_offset - of_fit[step] * lever
            turns[i, 1, step] += later_heading - of_fit[step]
            later_offset, later_heading = later_offset + whole[step, 0], later_heading + whole[step, 1]
    return turns, shifts, speeds


@compiled
def _weight_and_place(frame, half_length, bearing, mount, variances):  # type: ignore[no-untyped-def]
    """Return the weight of a beam in the fit of a line, and where it meets it, metres along it from its middle."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    x, y = mount[0] - frame[0], mount[1] - frame[1]
    start, distance = c * x + s * y, max(abs(c * y - s * x), MIN_WALL_DISTANCE)
    angle = mount[2] + bearing - frame[2]
    place = start + distance * math.cos(angle) / max(abs(math.sin(angle)), MIN_SINE)
    place = min(max(place, -half_length), half_length)
    square, along = distance**2, (place - start) ** 2
    return 1.0 / (variances[0] * square / (square + along) + variances[1] * along), place


def _jacobians(segments: Segments) -> Floats:
    """Return (n, 2, 3) the derivatives of each segment's offset and heading by a displacement [x, y, heading]."""
    jacobians = np.zeros((len(segments), 2, 3))
    jacobians[:, 0, 0], jacobians[:, 0, 1] = -np.sin(segments.frame[:, 2]), np.cos(segments.frame[:, 2])
    jacobians[:, 0, 2] = jacobians[:, 0, 1] * segments.frame[:, 0] - jacobians[:, 0, 0] * segments.frame[:, 1]
    jacobians[:, 1, 2] = 1.0
    return jacobians


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

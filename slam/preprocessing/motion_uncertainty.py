"""Uncertainty of odometry's motion during a sweep, added to the covariances of the scan's segments and corners.

A sweep is corrected with odometry's motion, whose random error is common to neighbouring beams: it does not average out
over a wall, and it bends the wall. At a beam, s metres of travel from the middle of the sweep and negative before it,
it is like an error of the robot's pose. The error of the position is s b with b ~ N(0, t I). That of the heading is a
random walk w with the variance q per metre in both directions. The reference of the sweep is the middle of a parabola
that is fitted to odometry from -l to l (see `deskew`), so the middle of that fitted to w is subtracted:

    e(s) = w(s) - int p(|u| / l) dw(u),    p(x) = (4 - 9 x + 5 x^3) / 8 for x < 1, else 0

The offset d and the heading h of a segment are sums over the distances of its beams from the line, with the gains g_k
of the weighted fit. Beam k ends at p_k, x_k along the line from its middle. With the directions t along and n across
the line, the motion moves it across the line by e(s_k) t'p_k + s_k n'b:

    [d, h] = sum_k g_k (e(s_k) t'p_k + s_k n'b),    g_k = w_k N^-1 [1, x_k],    N = sum_k w_k [1, x_k] [1, x_k]'

This is linear in b and in the steps of the random walk, STEPS on either side of the middle. Let the responses R_i
(2, m) of segment i be its changes by one standard deviation of each of these errors. Segments i and j share the
covariance

    K_ij = R_i R_j'

Segments enter the estimate as independent, with the covariances D_i + a K_ii instead: D_i is that of the sensor noise.
The factor a is chosen such that the covariance that this implies for the robot's pose is that of the same estimate with
the true K: with the weights W_i of each segment, the derivatives J_i by the pose, and H = sum_i J_i' W_i J_i,

    a = tr(H^-1 sum_ij J_i' W_i K_ij W_j J_j) / tr(H^-1 sum_i J_i' W_i K_ii W_i J_i)

It is at least one: so large is the error of a single segment.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.line_segments import MIN_WALL_DISTANCE
from ..geometry.segments import CornerPoints, Floats, Segments
from ..geometry.small_matrices import inverse
from ..odometry.error_model import OdometryModel
from .deskew import DeskewedScan

if TYPE_CHECKING:
    from features.types import Lines, Noise

# Steps of the random walk from the middle of a sweep to either end. Origin: numerical, with 64 the variances of the
# walls of a room differ by less than a hundredth in the median, and by 9 % at most.
STEPS = 16
# Iterations of the factor, which the information of the segments depends on. Origin: numerical, it changes by less than
# a hundredth after that.
ITERATIONS = 5
# Information of a pose that is added for conditioning: standard deviations of a kilometre. Origin: numerical.
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
) -> tuple[Segments, CornerPoints]:
    """Add odometry's uncertainty during the sweep to the covariances of segments and corners; see the module.

    segments, corners  of the scan, in the base's frame
    lines              from which the segments were made, in the same order
    noise              of a ray, from which the weights of the fit follow
    mount              pose of the lidar in the base's frame
    """
    if not len(segments) or not scan.travel.any():
        return segments, corners
    responses = _segment_responses(segments, lines, scan, model, noise, mount)
    motion = responses @ responses.transpose(0, 2, 1)
    inflation = _variance_inflation(segments.covariance, _pose_jacobians(segments), motion, responses)
    of_corners = _corner_covariances(segments.frame, corners.position, corners.segments, responses)
    return replace(segments, covariance=segments.covariance + inflation * motion), replace(
        corners, covariance=corners.covariance + inflation * of_corners
    )


def _segment_responses(
    segments: Segments, lines: Lines, scan: DeskewedScan, model: OdometryModel, noise: Noise, mount: se2.Pose
) -> Floats:
    """Return (n, 2, 2 STEPS + 2) the changes of offset and heading by one standard deviation of each error."""
    translation, rotation = (float(variance) for variance in model.variances(np.ones(())))  # after one metre
    reach = max(float(scan.travel.max()), scan.fitted)
    before = np.arange(len(scan.travel)) < int(np.argmin(scan.travel))
    turns, shifts = _unit_responses(
        segments.frame,
        segments.half_length,
        np.ascontiguousarray(lines.first),  # a column of one row is contiguous, and would be compiled for separately
        np.ascontiguousarray(lines.last),
        scan.bearings,
        np.where(before, -scan.travel, scan.travel),
        tuple(mount.tolist()),
        (noise.sigma_range**2, noise.sigma_bearing**2),
        reach,
        scan.fitted,
    )
    across = np.column_stack([-np.sin(segments.frame[:, 2]), np.cos(segments.frame[:, 2])])
    moved = math.sqrt(translation) * shifts[:, :, None] * across[:, None, :]
    return np.concatenate([math.sqrt(rotation * reach / STEPS) * turns, moved], axis=2)


@compiled
def _unit_responses(frames, half_lengths, first, last, bearings, travel, mount, variances, reach, fitted):  # type: ignore[no-untyped-def]
    """Return the changes of offset and heading of each segment by a unit of each error.

    By each step of the heading (n, 2, 2 STEPS), radians, and by the component n'b (n, 2) of the position. All beams
    from the `first` to the `last` one of a segment count as beams on it.

    frames     (n, 3) of the segments in the base's frame
    travel     (p,) metres from the middle of the sweep, negative before it
    variances  of range and bearing of a ray
    reach      metres from the middle that the steps cover on either side
    fitted     metres from there to either end of the interval that the reference is fitted to
    """
    turns, shifts = np.zeros((len(frames), 2, 2 * STEPS)), np.zeros((len(frames), 2))
    count, width = len(bearings), reach / STEPS
    weights, places = np.empty(count), np.empty(count)
    for i in range(len(frames)):
        lever = math.cos(frames[i, 2]) * frames[i, 0] + math.sin(frames[i, 2]) * frames[i, 1]
        beams, whole = (last[i] - first[i]) % count + 1, np.zeros((2 * STEPS, 2))  # of beams by the step they end in
        total = one = two = 0.0
        for b in range(beams):
            bearing = bearings[(first[i] + b) % count]
            weights[b], places[b] = _weight_and_place(frames[i], half_lengths[i], bearing, mount, variances)
            total, one, two = total + weights[b], one + weights[b] * places[b], two + weights[b] * places[b] ** 2
        determinant = max(total * two - one * one, SMALLEST)
        for b in range(beams):
            s, arm = travel[(first[i] + b) % count], places[b] + lever
            offset = weights[b] * (two - one * places[b]) / determinant
            heading = weights[b] * (total * places[b] - one) / determinant
            shifts[i, 0], shifts[i, 1] = shifts[i, 0] + offset * s, shifts[i, 1] + heading * s
            passed = abs(s) / width
            step = min(int(passed), STEPS - 1)
            column = step if s < 0.0 else STEPS + step
            whole[column, 0], whole[column, 1] = whole[column, 0] + offset * arm, whole[column, 1] + heading * arm
            turns[i, 0, column] += (passed - step) * offset * arm
            turns[i, 1, column] += (passed - step) * heading * arm
        _add_whole_steps(turns[i], whole)
        for step in range(STEPS):
            of_fit = _share_in_fit((step + 0.5) * width, fitted)
            for side in (0, STEPS):
                turns[i, 0, side + step] -= of_fit * lever
                turns[i, 1, side + step] -= of_fit
    return turns, shifts


@compiled
def _add_whole_steps(turns, whole):  # type: ignore[no-untyped-def]
    """Add, to the responses (2, 2 STEPS) of a segment to each step, those of the beams that end in later steps.

    whole  (2 STEPS, 2) sums over the beams that end in each step, as if they had the whole step
    """
    for side in (0, STEPS):
        offset = heading = 0.0
        for step in range(STEPS - 1, -1, -1):
            turns[0, side + step] += offset
            turns[1, side + step] += heading
            offset, heading = offset + whole[side + step, 0], heading + whole[side + step, 1]


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


@compiled
def _share_in_fit(travel, fitted):  # type: ignore[no-untyped-def]
    """Return p of the module's documentation: the share of a step of the random walk in the middle of the parabola."""
    if travel >= fitted:
        return 0.0
    part = travel / fitted
    return (4.0 - 9.0 * part + 5.0 * part**3) / 8.0


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
def _variance_inflation(covariances, jacobians, motion, responses):  # type: ignore[no-untyped-def]
    """Return the variance inflation factor a of the module's documentation.

    covariances  (n, 2, 2) of the segments without the motion
    jacobians    (n, 2, 3) by the pose
    motion       (n, 2, 2) K_ii
    responses    (n, 2, m) R_i
    """
    inflation = 1.0
    for _ in range(ITERATIONS):
        information, separate, correlated = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
        together = np.zeros((3, responses.shape[2]))
        for i in range(len(covariances)):
            gain = _gain(covariances[i] + inflation * motion[i], jacobians[i])
            for k in range(3):
                for m in range(3):
                    information[k, m] += gain[k, 0] * jacobians[i, 0, m] + gain[k, 1] * jacobians[i, 1, m]
                    of_offset = gain[k, 0] * motion[i, 0, 0] + gain[k, 1] * motion[i, 1, 0]
                    of_heading = gain[k, 0] * motion[i, 0, 1] + gain[k, 1] * motion[i, 1, 1]
                    separate[k, m] += of_offset * gain[m, 0] + of_heading * gain[m, 1]
                for m in range(responses.shape[2]):
                    together[k, m] += gain[k, 0] * responses[i, 0, m] + gain[k, 1] * responses[i, 1, m]
        for k in range(3):
            information[k, k] += CONDITIONING
            for m in range(3):
                for n in range(responses.shape[2]):
                    correlated[k, m] += together[k, n] * together[m, n]
        covariance, implied, actual = inverse(information), 0.0, 0.0
        for k in range(3):
            for m in range(3):  # the traces of products, as all are symmetric
                implied += covariance[k, m] * separate[k, m]
                actual += covariance[k, m] * correlated[k, m]
        if implied <= 0.0:
            return 1.0
        inflation = max(1.0, actual / implied)
    return inflation


@compiled
def _gain(covariance, jacobian):  # type: ignore[no-untyped-def]
    """Return J' W (3, 2) of a segment with the covariance W^-1 (2, 2), and the derivatives J (2, 3) by the pose."""
    both = covariance[0, 1]
    determinant = covariance[0, 0] * covariance[1, 1] - both * both
    gain = np.empty((3, 2))
    for k in range(3):
        offset, heading = jacobian[0, k], jacobian[1, k]
        gain[k, 0] = (covariance[1, 1] * offset - both * heading) / determinant
        gain[k, 1] = (covariance[0, 0] * heading - both * offset) / determinant
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

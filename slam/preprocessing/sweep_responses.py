"""Changes of the segments of a scan by errors of odometry's motion during its sweep.

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
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.line_segments import MIN_WALL_DISTANCE
from ..geometry.segments import Floats, Segments
from ..odometry.error_model import OdometryModel
from .sweep_motion import SweepMotion

if TYPE_CHECKING:
    from features.types import Lines, Noise

# Sine of the least angle between a beam and a wall, and least determinant of the fit of a line, for conditioning.
# Origin: numerical.
MIN_SINE = 1e-6
SMALLEST = float(np.finfo(float).tiny)


def segment_responses(
    segments: Segments,
    lines: Lines,
    bearings: Floats,
    motion: SweepMotion,
    model: OdometryModel,
    noise: Noise,
    mount: se2.Pose,
) -> Floats:
    """Return (n, 2, m + 4) the changes of offset and heading by one standard deviation of each error."""
    position_sigma = math.sqrt(float(model.variances(np.ones(()))[0]))  # after one metre
    heading_sigma = math.sqrt(float(model.variances(np.array(motion.offset))[1]))
    return np.asarray(
        _responses(
            segments.frame,
            segments.half_length,
            # a column of one row is contiguous, and would be compiled for separately
            np.ascontiguousarray(lines.first),
            np.ascontiguousarray(lines.last),
            bearings,
            (motion.times, motion.travel, motion.offset, motion.poses),
            (motion.breakpoints, motion.fitted),
            tuple(mount.tolist()),
            (noise.sigma_range**2, noise.sigma_bearing**2),
            np.sqrt(model.variances(motion.steps)[1]),
            (position_sigma, heading_sigma, motion.speed_error),
        )
    )


@compiled
def _responses(frames, half_lengths, first, last, bearings, beams, walk, mount, variances, step_sigmas, sigmas):  # type: ignore[no-untyped-def]
    """Return (n, 2, m + 4) the changes of offset and heading of each segment by one standard deviation of each error.

    The errors are those of the m steps of the heading, of both components of the position, of the heading between the
    middle and the stamp of the scan, and of the speed.

    frames       (n, 3) of the segments in the base's frame
    first, last  (n,) beams of each segment: all from one to the other count as beams on it
    bearings     (p,) of the beams
    beams        (p,) seconds from the middle of the sweep, (p,) metres of wheel travel from there, metres from there to
                 the stamp, and (p, 3) poses of the base
    walk         (m + 1,) seconds from the middle to the ends of the steps, and `fitted` as in `SweepMotion`
    variances    of range and bearing of a ray
    step_sigmas  (m,) radians, of the steps
    sigmas       of the position per metre, of the heading up to the stamp (radians), and of the relative speed
    """
    times, distances, offset, poses = beams
    steps, travel = len(step_sigmas), np.copysign(distances, times) + offset
    interval, part = _places_in_steps(times, walk[0])
    turns, shifts, speeds = _unit_responses(
        frames, half_lengths, first, last, bearings, travel, poses,
        (interval, part, _shares_in_fit(walk[0], walk[1])), mount, variances,
    )  # fmt: skip
    result = np.empty((len(frames), 2, steps + 4))
    for i in range(len(frames)):
        x, y, c, s = frames[i, 0], frames[i, 1], math.cos(frames[i, 2]), math.sin(frames[i, 2])
        for row in range(2):
            for step in range(steps):
                result[i, row, step] = step_sigmas[step] * turns[i, row, step]
            result[i, row, steps] = -s * sigmas[0] * shifts[i, row]
            result[i, row, steps + 1] = c * sigmas[0] * shifts[i, row]
            result[i, row, steps + 2] = sigmas[1] * (c * x + s * y if row == 0 else 1.0)
            result[i, row, steps + 3] = sigmas[2] * speeds[i, row]
    return result


@compiled
def _places_in_steps(times, breakpoints):  # type: ignore[no-untyped-def]
    """Return (p,) the step between `breakpoints` (m + 1,) that each of some times is in, and how much of it is over."""
    interval, part = np.empty(len(times), dtype=np.int64), np.empty(len(times))
    for k in range(len(times)):
        step = np.searchsorted(breakpoints, times[k], side="right") - 1
        step = min(max(step, 0), len(breakpoints) - 2)
        interval[k] = step
        part[k] = (times[k] - breakpoints[step]) / (breakpoints[step + 1] - breakpoints[step])
    return interval, part


@compiled
def _shares_in_fit(breakpoints, fitted):  # type: ignore[no-untyped-def]
    """Return (m,) what the middle of the fitted parabola has of each step of the random walk, between `breakpoints`.

    A step r rises from 0 to 1 between its breakpoints a and b. With V = int v, which is 0 before -1 and 1 after 1,

        int_-1^1 v(x) r(l x) dx = 1 - int_a^b V(u / l) du / (b - a)
    """
    integral = np.empty(len(breakpoints))
    for k in range(len(breakpoints)):
        if abs(breakpoints[k]) < fitted:
            x = breakpoints[k] / fitted
            integral[k] = fitted * (3.0 + 16.0 * x + 18.0 * x**2 - 5.0 * x**4) / 32.0
        else:
            integral[k] = max(breakpoints[k], 0.0)
    return 1.0 - (integral[1:] - integral[:-1]) / (breakpoints[1:] - breakpoints[:-1])


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
    """Return the weight of a beam in the fit of a line, and where it meets the line, metres from the line's middle."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    x, y = mount[0] - frame[0], mount[1] - frame[1]
    start, distance = c * x + s * y, max(abs(c * y - s * x), MIN_WALL_DISTANCE)
    angle = mount[2] + bearing - frame[2]
    place = start + distance * math.cos(angle) / max(abs(math.sin(angle)), MIN_SINE)
    place = min(max(place, -half_length), half_length)
    square, along = distance**2, (place - start) ** 2
    return 1.0 / (variances[0] * square / (square + along) + variances[1] * along), place


def segment_jacobians(segments: Segments) -> Floats:
    """Return (n, 2, 3) the derivatives of each segment's offset and heading by a displacement [x, y, heading]."""
    jacobians = np.zeros((len(segments), 2, 3))
    jacobians[:, 0, 0], jacobians[:, 0, 1] = -np.sin(segments.frame[:, 2]), np.cos(segments.frame[:, 2])
    jacobians[:, 0, 2] = jacobians[:, 0, 1] * segments.frame[:, 0] - jacobians[:, 0, 0] * segments.frame[:, 1]
    jacobians[:, 1, 2] = 1.0
    return jacobians

"""Paths of odometry without their systematic errors, and the covariances of their ends, in compiled code.

A path is a chain of poses. Its systematic errors are corrected from pose to pose, as those of the whole motion depend
on where the robot has turned.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled, inlined

from ..geometry.angles import wrap_angle
from ..geometry.pose_arrays import wrapped
from .history import QUARTER_TURN, TRAVEL_PER_RADIAN


@compiled
def corrected_motions(motions, length, turning, veer, frame):  # type: ignore[no-untyped-def]
    """Return motions (n, 3) without systematic errors, see `SystematicErrors`."""
    corrected = np.empty(motions.shape)
    for k in range(len(motions)):
        x, y, turn = _corrected(motions[k, 0], motions[k, 1], motions[k, 2], length, turning, veer, frame)
        corrected[k, 0], corrected[k, 1], corrected[k, 2] = x, y, wrap_angle(turn)
    return corrected


@compiled
def motion_along(poses, length, turning, veer, frame):  # type: ignore[no-untyped-def]
    """Return (3,) the motion along a path of measured poses (n, 3) without systematic errors."""
    return _end(corrected_path(poses, length, turning, veer, frame))


@compiled
def motion_and_covariance(  # type: ignore[no-untyped-def]
    poses, length, turning, veer, frame, rates, floors, systematic, correlation_length
):
    """Return the motion along a path, see `motion_along`, and its covariance, see `path_covariance`."""
    path = corrected_path(poses, length, turning, veer, frame)
    return _end(path), path_covariance(path, rates, floors, systematic, turning, correlation_length)


@compiled
def motions_along(poses, nodes, first, last, length, turning, veer, frame):  # type: ignore[no-untyped-def]
    """Return the motions (n - 1, 3) from each of measured poses (n, 3) to the next one, see `motion_along`.

    The nodes (m, 3) of the path from pose k to the next one are those from `first[k]` to before `last[k]`.
    """
    motions = np.empty((len(first), 3))
    for k in range(len(first)):
        path = _path_through(poses[k], nodes[first[k] : last[k]], poses[k + 1])
        motions[k] = motion_along(path, length, turning, veer, frame)
    return motions


@compiled
def motions_and_covariances(  # type: ignore[no-untyped-def]
    poses, nodes, first, last, length, turning, veer, frame, rates, floors, systematic, correlation_length
):
    """Return the same motions as `motions_along`, and their covariances (n - 1, 3, 3), see `path_covariance`."""
    motions, covariances = np.empty((len(first), 3)), np.empty((len(first), 3, 3))
    for k in range(len(first)):
        path = _path_through(poses[k], nodes[first[k] : last[k]], poses[k + 1])
        motions[k], covariances[k] = motion_and_covariance(
            path, length, turning, veer, frame, rates, floors, systematic, correlation_length
        )
    return motions, covariances


@compiled
def _path_through(begin, nodes, end):  # type: ignore[no-untyped-def]
    """Return the path (n + 2, 3) from one pose to another through some nodes (n, 3)."""
    path = np.empty((len(nodes) + 2, 3))
    path[0], path[1:-1], path[-1] = begin, nodes, end
    return path


@compiled
def _end(path):  # type: ignore[no-untyped-def]
    """Return a copy (3,) of the last pose of a path (n, 3), with a heading from -pi to pi."""
    end = path[-1].copy()
    end[2] = wrapped(end[2])
    return end


@compiled
def corrected_path(poses, length, turning, veer, frame):  # type: ignore[no-untyped-def]
    """Return the poses (n, 3) of a path without systematic errors, relative to the first; their headings are unwrapped.

    poses  (n, 3) as measured
    """
    path = np.zeros(poses.shape)
    for k in range(1, len(poses)):
        x, y = poses[k, 0] - poses[k - 1, 0], poses[k, 1] - poses[k - 1, 1]
        c, s = math.cos(poses[k - 1, 2]), math.sin(poses[k - 1, 2])
        turn = wrap_angle(poses[k, 2] - poses[k - 1, 2])
        x, y, turn = _corrected(c * x + s * y, c * y - s * x, turn, length, turning, veer, frame)
        c, s = math.cos(path[k - 1, 2]), math.sin(path[k - 1, 2])
        path[k, 0], path[k, 1] = path[k - 1, 0] + c * x - s * y, path[k - 1, 1] + s * x + c * y
        path[k, 2] = path[k - 1, 2] + turn
    return path


@inlined
def _corrected(ahead, left, turned, length, turning, veer, frame):  # type: ignore[no-untyped-def]
    """Return a motion without systematic errors: first those of the wheels, then that of odometry's frame."""
    turn = turning * turned + veer * ahead
    # The chord of an arc points ahead by half its turn.
    bend = 0.5 * (turn - turned) + frame[2]
    c, s = length * math.cos(bend), length * math.sin(bend)
    x, y = c * ahead - s * left, s * ahead + c * left
    c, s = math.cos(turn), math.sin(turn)
    return x + frame[0] - c * frame[0] + s * frame[1], y + frame[1] - s * frame[0] - c * frame[1], turn


@compiled
def path_covariance(path, rates, floors, systematic, turning, correlation_length):  # type: ignore[no-untyped-def]
    """Return (3, 3) the covariance of the end of a corrected path relative to its begin, in the frame of the end.

    path        (n, 3) poses with unwrapped headings, see `corrected_path`
    rates       (4,) variances of the random errors, see `OdometryModel`
    floors      (2,) standard deviations of a single reading
    systematic  (6,) variances of the systematic errors, see `SystematicErrors`
    turning     factor that turns were corrected by: wrongly, if a large one was in the other direction
    correlation_length  metres of travel up to which the errors of the position are taken as equal

    A heading error at a place p turns the rest of the path, e - p, about p, where e is the end. Averaged over a
    straight part m with the middle q, the square of the rest is (e - q)^2, and m^2 / 12 more along m. The random walk
    of the heading is the sum of these squares times the variance that the walk gains there. An error of the factor of
    turning, or of veering, makes heading errors in proportion to the turns, or to the way ahead; they add up before
    they are squared. The position errs in proportion to the travel up to the correlation length, and as a random walk
    beyond. An error v of the position of odometry's frame moves the end by (R - I) v, where R rotates by the negative
    turn.
    """
    end = path[-1]
    c, s = math.cos(end[2]), math.sin(end[2])
    xx, xy, yy = 0.0, 0.0, 0.0
    walk, x_walk, y_walk, xx_walk, xy_walk, yy_walk = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    turned, x_turned, y_turned, ahead, x_ahead, y_ahead = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    travelled = 0.0
    for k in range(1, len(path)):
        x, y, turn = path[k, 0] - path[k - 1, 0], path[k, 1] - path[k - 1, 1], path[k, 2] - path[k - 1, 2]
        step_ahead = math.cos(path[k - 1, 2]) * x + math.sin(path[k - 1, 2]) * y
        travel = math.hypot(x, y) + TRAVEL_PER_RADIAN * abs(turn)
        # in the frame of the end: the rest of the path from the middle of this part, and this part
        x_rest, y_rest = end[0] - path[k, 0] + 0.5 * x, end[1] - path[k, 1] + 0.5 * y
        x_rest, y_rest, x, y = c * x_rest + s * y_rest, c * y_rest - s * x_rest, c * x + s * y, c * y - s * x
        variance = rates[2] * travel + rates[3] * abs(turn)
        if abs(turn) > QUARTER_TURN:  # two poses do not tell its direction
            variance += (2.0 * math.pi * (turning - 1.0)) ** 2
        walk += variance
        x_walk += variance * x_rest
        y_walk += variance * y_rest
        xx_walk += variance * (x_rest * x_rest + x * x / 12.0)
        xy_walk += variance * (x_rest * y_rest + x * y / 12.0)
        yy_walk += variance * (y_rest * y_rest + y * y / 12.0)
        turned += turn
        x_turned += turn * x_rest
        y_turned += turn * y_rest
        ahead += step_ahead
        x_ahead += step_ahead * x_rest
        y_ahead += step_ahead * y_rest
        travelled += travel
        cos, sin = math.cos(path[k, 2] - end[2]), math.sin(path[k, 2] - end[2])
        along, across = travel * rates[0], travel * rates[1]
        xx += along * cos * cos + across * sin * sin
        xy += (along - across) * cos * sin
        yy += along * sin * sin + across * cos * cos
    length = min(travelled, correlation_length)
    covariance = np.empty((3, 3))
    covariance[0, 0] = length * xx + floors[0] ** 2 + yy_walk
    covariance[0, 1] = length * xy - xy_walk
    covariance[1, 1] = length * yy + floors[0] ** 2 + xx_walk
    covariance[0, 2], covariance[1, 2], covariance[2, 2] = -y_walk, x_walk, walk + floors[1] ** 2
    x, y = end[0] - path[0, 0], end[1] - path[0, 1]
    x, y, turn = c * x + s * y, c * y - s * x, end[2] - path[0, 2]
    c, s = math.cos(turn) - 1.0, math.sin(turn)
    _add_square(covariance, systematic[0], x, y, 0.0)
    _add_square(covariance, systematic[1], -y_turned, x_turned, turned)
    _add_square(covariance, systematic[2], -y_ahead, x_ahead, ahead)
    _add_square(covariance, systematic[3], c, -s, 0.0)
    _add_square(covariance, systematic[4], s, c, 0.0)
    _add_square(covariance, systematic[5], -y, x, 0.0)
    covariance[1, 0], covariance[2, 0], covariance[2, 1] = covariance[0, 1], covariance[0, 2], covariance[1, 2]
    return covariance


@inlined
def _add_square(covariance, variance, x, y, heading):  # type: ignore[no-untyped-def]
    """Add the variance of an error that moves the end by [x, y, heading] to the upper half of a covariance (3, 3)."""
    covariance[0, 0] += variance * x * x
    covariance[0, 1] += variance * x * y
    covariance[0, 2] += variance * x * heading
    covariance[1, 1] += variance * y * y
    covariance[1, 2] += variance * y * heading
    covariance[2, 2] += variance * heading * heading

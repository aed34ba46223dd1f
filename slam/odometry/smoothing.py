"""Smooth odometry around a sweep, as its stamps are not exact.

A reading that is stamped when it arrives is late by what the bus and the scheduler took, each by another time. At a
speed v it is off by v times the error of its stamp (see `error_of_stamps`), and the motion between two neighbours by
much more than odometry's own error.

The motion is modelled as an integrated Wiener process: the acceleration is white with the spectral density q. Each
coordinate is smoothed with the same gains (Rauch, Tung and Striebel 1965), for errors of readings with the variance
(v sigma)^2 + r^2. Between two readings the smoothed motion is the cubic that has the smoothed positions and velocities
at both. Where it is farther from the readings than their errors explain, the robot has changed its speed suddenly; so
the difference is limited.

What is left of the errors of the stamps makes the motion during a sweep too fast or too slow. The smoothed positions x
are linear in those of the readings z, with a symmetric matrix: they minimise |x - z|^2 / r^2 + x' K x. So the gains of
the difference between two of them are the result of smoothing 1 at one and -1 at the other.
"""

from __future__ import annotations

import numpy as np

from drivers.compiled import compiled
from features.normal_limits import NORMAL_LIMIT

from ..geometry.normal_distribution import NORMAL_SCALE
from ..geometry.pose_arrays import between_each, compose_each, unwrapped
from ..geometry.segments import Floats
from .history import OdometryHistory, deviations_of_triples, wheel_travel

# Metres^2 per second^3, spectral density of the wheels' acceleration. Origin: chosen, 0.5 m/s^2 for 0.4 s; with five
# times as much, the NEES of simulated drives is up to a tenth larger, with a fifth of it smaller.
ACCELERATION_DENSITY = 0.1
# Metres, metres, radians: jitter of a reading whose stamp is exact: 0.2 mm at either wheel. Origin: measured on a
# standing robot; the data are not recorded.
JITTER = np.array([2e-4, 2e-4, 8e-4])
# Seconds before the sweep from which readings are used, with those up to the first one after it: a live run knows no
# others. Origin: numerical, with errors of 50 ms at 50 Hz, readings that are 80 ms away have 1/e of the weight.
REACH = 0.5
# Readings at least: fewer do not tell errors from motion. Origin: definition, two more than a line has parameters.
MIN_READINGS = 4
# Variance of the velocity before the first reading, relative to ACCELERATION_DENSITY. Origin: numerical, unknown.
UNKNOWN = 1e6


def smoothed_poses(odometry: OdometryHistory, stamps: Floats) -> tuple[Floats, float]:
    """Return the poses (n, 3) of odometry at increasing stamps (n,), seconds, smoothed over readings up to the last.

    Returns also the standard deviation of the relative error of their speed by inexact stamps of the readings. If there
    are too few readings, or the stamps are not between them, the poses are interpolated as by `OdometryHistory`.
    """
    interpolated = odometry.at_each(stamps)
    times, readings = odometry.readings_between(float(stamps[0]) - REACH, float(stamps[-1]))
    if len(times) < MIN_READINGS or not times[0] <= stamps[0] <= stamps[-1] <= times[-1]:
        return interpolated, 0.0
    origin = readings[np.searchsorted(times, stamps[0]) - 1]
    moves = between_each(origin[None], readings)
    moves[:, 2] = unwrapped(moves[:, 2].copy())
    steps, duration = between_each(readings[:-1], readings[1:]), times[-1] - times[0]
    stamp_error = odometry.stamp_error(float(stamps[0]))
    error = stamp_error * wheel_travel(steps).sum() / duration
    ratio = (error**2 + JITTER[0] ** 2) / ACCELERATION_DENSITY
    smoothed = compose_each(origin[None], _smoothed(times - stamps[0], moves, ratio, stamps - stamps[0]))
    limit = JITTER + NORMAL_LIMIT * stamp_error * np.abs(steps).sum(axis=0) / duration
    limited = np.clip(between_each(interpolated, smoothed), -limit, limit)
    speed_error = stamp_error * _gain_of_speed(times, ratio, float(stamps[0]))
    return np.asarray(compose_each(interpolated, limited)), speed_error


def is_within_jitter(odometry: OdometryHistory, begin: float, end: float, travel: float) -> bool:
    """Return True if a motion during a sweep, and the trend of the readings around it, can be jitter of the readings.

    begin, end  stamps of the sweep, seconds; readings up to REACH before it count
    travel      metres of wheel travel from one to the other

    The median deviation of three readings from a line tells the jitter, and ignores changes of speed. If a robot moves
    steadily, errors of stamps look like jitter, too, but its readings have a trend, which is fitted by least squares.
    False if there are too few readings.
    """
    times, readings = odometry.readings_between(begin - REACH, end)
    if len(times) < MIN_READINGS:
        return False
    poses = between_each(readings[:1], readings)
    poses[:, 2] = unwrapped(poses[:, 2].copy())
    error, factor = deviations_of_triples(times, poses)
    jitter = NORMAL_SCALE * float(wheel_travel(np.median(np.abs(error / factor), axis=0)))
    centred = times - times.mean()
    trend = float(wheel_travel(centred @ poses / float(np.linalg.norm(centred))))
    return travel < NORMAL_LIMIT * 2**0.5 * jitter and trend < NORMAL_LIMIT * jitter


def _gain_of_speed(times: Floats, ratio: float, begin: float) -> float:
    """Return by how much the mean speed from `begin` (seconds) on varies if the stamps vary independently, 1/s."""
    first = int(np.searchsorted(times, begin, side="right")) - 1
    ends = np.zeros((len(times), 3))
    ends[first, 0], ends[-1, 0] = -1.0, 1.0
    gains = _smoothed_states(times, ends, ratio)[:, 0]
    return float(np.linalg.norm(gains) / (times[-1] - times[first]))


@compiled
def _smoothed(times, poses, ratio, wanted):  # type: ignore[no-untyped-def]
    """Return (m, 3) the smoothed poses at the `wanted` times (m,), which increase and are within those of the readings.

    times  (n,) of the readings, seconds
    poses  (n, 3), headings unwrapped
    ratio  variance of a reading divided by the spectral density of the acceleration
    """
    states = _smoothed_states(times, poses, ratio)
    result = np.empty((len(wanted), 3))
    after = 1
    for k in range(len(wanted)):
        while after < len(times) - 1 and times[after] < wanted[k]:
            after += 1
        step = times[after] - times[after - 1]
        x = (wanted[k] - times[after - 1]) / step
        for i in range(3):
            begin, end = states[after - 1], states[after]
            rise = end[i] - begin[i]
            first, last = step * begin[3 + i] - rise, rise - step * end[3 + i]
            result[k, i] = begin[i] + x * rise + x * (1.0 - x) * ((1.0 - x) * first + x * last)
    return result


@compiled
def _smoothed_states(times, poses, ratio):  # type: ignore[no-untyped-def]
    """Return (n, 6) the smoothed poses and their velocities at the readings; arguments as for `_smoothed`."""
    count = len(times)
    states, predicted = np.zeros((count, 6)), np.zeros((count, 6))
    # variances of position, both, and velocity, the same for all coordinates
    updated_p, updated_c, updated_v = np.empty(count), np.empty(count), np.empty(count)
    p, c, v = ratio, 0.0, UNKNOWN
    states[0, 0], states[0, 1], states[0, 2] = poses[0, 0], poses[0, 1], poses[0, 2]
    updated_p[0], updated_c[0], updated_v[0] = p, c, v
    for k in range(1, count):
        step = times[k] - times[k - 1]
        p, c, v = p + 2.0 * step * c + step**2 * v + step**3 / 3.0, c + step * v + step**2 / 2.0, v + step
        gain_p, gain_v = p / (p + ratio), c / (p + ratio)
        for i in range(3):
            predicted[k, i], predicted[k, 3 + i] = states[k - 1, i] + step * states[k - 1, 3 + i], states[k - 1, 3 + i]
            error = poses[k, i] - predicted[k, i]
            states[k, i], states[k, 3 + i] = predicted[k, i] + gain_p * error, predicted[k, 3 + i] + gain_v * error
        p, c, v = (1.0 - gain_p) * p, (1.0 - gain_p) * c, v - gain_v * c
        updated_p[k], updated_c[k], updated_v[k] = p, c, v
    for k in range(count - 2, -1, -1):
        step = times[k + 1] - times[k]
        p, c, v = updated_p[k], updated_c[k], updated_v[k]
        next_p, next_c = p + 2.0 * step * c + step**2 * v + step**3 / 3.0, c + step * v + step**2 / 2.0
        next_v = v + step
        # gain: covariance with the next state, times the inverse of that state's covariance
        determinant = next_p * next_v - next_c**2
        with_p, with_v = p + step * c, c + step * v  # of the next position
        gain_pp, gain_pv = (with_p * next_v - c * next_c) / determinant, (c * next_p - with_p * next_c) / determinant
        gain_vp, gain_vv = (with_v * next_v - v * next_c) / determinant, (v * next_p - with_v * next_c) / determinant
        for i in range(3):
            of_p, of_v = states[k + 1, i] - predicted[k + 1, i], states[k + 1, 3 + i] - predicted[k + 1, 3 + i]
            states[k, i] += gain_pp * of_p + gain_pv * of_v
            states[k, 3 + i] += gain_vp * of_p + gain_vv * of_v
    return states

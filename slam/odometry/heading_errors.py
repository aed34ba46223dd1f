"""Systematic errors of the heading: a factor of turns, and veering in proportion to the way ahead.

They follow from a robust linear regression (Huber 1964) over sums of motions. The stamps of odometry and of the scans
are not exact, so a part of a turn may be measured in one motion and registered in the next one. Both are then off by
the same angle in opposite directions, which cancels in their sum. In the median of single motions, many small errors
one way and few large ones the other way would seem to be a systematic error.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled
from features.normal_limits import GROSS_LIMIT, NORMAL_LIMIT

from ..geometry.angles import wrap_angle
from ..geometry.median import median
from ..geometry.normal_distribution import NORMAL_SCALE
from ..geometry.pose_covariance import POSE_SIGMAS
from .history import TRAVEL_PER_RADIAN

# Metres of wheel travel over which motions are summed. Origin: measured, on seven recordings dead reckoning over 20 m
# errs least with 1 to 2 m: by up to a quarter less than with the medians of single motions.
SUMMED_TRAVEL = 1.0
# Radians: motions that turn by more, as measured and as registered, are turns. Origin: definition, more than the errors
# of the headings at both ends explain.
MAX_STRAIGHT_TURN = NORMAL_LIMIT * math.sqrt(2.0) * float(POSE_SIGMAS[2])
# Standard deviations beyond which an error counts with a constant instead of a growing force. Origin: definition, for
# an efficiency of 95 % with normal errors (Huber 1964).
HUBER_LIMIT = 1.345
# Times that the weights are computed anew. Origin: numerical, more change the results by a third of their standard
# deviations at most.
ITERATIONS = 5


@compiled
def is_turn(measured, registered):  # type: ignore[no-untyped-def]
    """Return whether a motion is a turn, by its turns (radians) as measured and as registered.

    One of them does not suffice. If wheels slip, most measured turns of a straight drive are errors; gross errors of
    registration look like turns, too.
    """
    return min(abs(measured), abs(registered)) > MAX_STRAIGHT_TURN


@compiled
def heading_errors(samples, expected, sigmas, walk, prior_samples):  # type: ignore[no-untyped-def]
    """Return the means (2,) and variances (2,) of the factor of turning and of veering.

    samples   (n, 8) motions as measured by odometry and as registered, with variances
    expected  (2,) means before the drive
    sigmas    (2,) their standard deviations
    walk, prior_samples  variance of the heading per metre before the drive, and the number of sums it counts for

    The difference between both turns is regressed on the measured turn and on the way ahead. That of single motions
    gives the usual errors; then sums are regressed, without those with gross errors.
    """
    prior = np.array([expected[0] - 1.0, expected[1], sigmas[0] ** -2.0, sigmas[1] ** -2.0])
    share, veer, of_share, of_veer, variance = prior[0], prior[1], sigmas[0] ** 2, sigmas[1] ** 2, walk
    motions = _sums(samples, 0.0)
    for _ in range(ITERATIONS if len(samples) else 0):
        spread = (NORMAL_SCALE * median(np.abs(_errors(motions, share, veer)))) ** 2
        variance = (prior_samples * walk + len(motions) * spread) / (prior_samples + len(motions))
        share, veer, of_share, of_veer = _step(motions, prior, share, veer, variance, np.inf)
    sums = _sums(samples, SUMMED_TRAVEL)
    for _ in range(ITERATIONS if len(samples) else 0):
        share, veer, of_share, of_veer = _step(sums, prior, share, veer, variance, GROSS_LIMIT)
    return np.array([1.0 + share, veer]), np.array([of_share, of_veer])


@compiled
def _sums(samples, least):  # type: ignore[no-untyped-def]
    """Return the sums (m, 5) of motions over some metres of travel each, `least` at least.

    They are the difference of the turns, the measured turns of motions that are turns, the way ahead, and the travel.
    The last column is the root of the travel.
    """
    sums, count = np.zeros((len(samples), 5)), 0
    for k in range(len(samples)):
        ahead, turn = samples[k, 0], samples[k, 2]
        sums[count, 0] += wrap_angle(samples[k, 5] - turn)
        sums[count, 1] += turn if is_turn(turn, samples[k, 5]) else 0.0
        sums[count, 2] += ahead
        sums[count, 3] += math.hypot(ahead, samples[k, 1]) + TRAVEL_PER_RADIAN * abs(turn)
        if sums[count, 3] >= least or k == len(samples) - 1:
            sums[count, 4] = math.sqrt(sums[count, 3])
            count += 1
    return sums[:count]


@compiled
def _errors(sums, share, veer):  # type: ignore[no-untyped-def]
    """Return the errors (m,) of the heading, relative to a random walk with the variance 1 rad^2 / m."""
    return (sums[:, 0] - share * sums[:, 1] - veer * sums[:, 2]) / sums[:, 4]


@compiled
def _step(sums, prior, share, veer, variance, limit):  # type: ignore[no-untyped-def]
    """Return the share of the turns that is missing, the veering, and their variances, given the last two values.

    prior     (4,) the same before the drive, with inverse variances
    variance  of the heading per metre
    limit     standard deviations beyond which an error does not count
    """
    errors = np.abs(_errors(sums, share, veer)) / math.sqrt(variance)
    a, b, c = prior[2], 0.0, prior[3]
    p, q = prior[2] * prior[0], prior[3] * prior[1]
    for k in range(len(sums)):
        if errors[k] <= limit:
            weight = HUBER_LIMIT / max(errors[k], HUBER_LIMIT) / (variance * sums[k, 3])
            a += weight * sums[k, 1] ** 2
            b += weight * sums[k, 1] * sums[k, 2]
            c += weight * sums[k, 2] ** 2
            p += weight * sums[k, 1] * sums[k, 0]
            q += weight * sums[k, 2] * sums[k, 0]
    determinant = a * c - b * b
    return (c * p - b * q) / determinant, (a * q - b * p) / determinant, c / determinant, a / determinant

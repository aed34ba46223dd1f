"""Systematic errors of wheel odometry: those that all motions of a robot share.

Wrong wheel diameters scale the length of a motion by a factor, a wrong distance between the wheels scales turns by
another, and unequal wheels veer in proportion to the length. Odometry describes the motion of its own frame, the middle
of the axle that the robot turns around. If the pose of the lidar on the base is not known exactly, or the wheels slip,
that frame F is not the base's: with its pose q in the base's frame, the base moves by q M q^-1 if F moves by M.

The estimates are medians, which single gross errors do not affect; for those of the heading see `heading_errors`.
"""

from __future__ import annotations

import math
from dataclasses import field

import numpy as np

from drivers import se2
from drivers.compiled import compiled
from drivers.immutable import immutable

from ..geometry.angles import wrap_angle
from ..geometry.median import median
from ..geometry.normal_distribution import NORMAL_MEDIAN
from ..geometry.segments import Floats
from .heading_errors import heading_errors, is_turn
from .history import MIN_MOTION_TRAVEL
from .path_errors import corrected_motions

# Motions that the values before any driving count for. Origin: chosen, so few that the first metres of driving correct
# a wrong value; not measured.
PRIOR_SAMPLES = 10
# Values of perfect odometry: length, turning, veer, and the pose of odometry's frame. Origin: definition.
PERFECT = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
# Standard deviations of the systematic errors before a drive: relative ones of length and of turning, veering in
# radians per metre, and the pose of odometry's frame, metres and radians. Origin: chosen, wheels within 3 % of their
# nominal size and distance, that differ by 0.5 % at a distance of half a metre; a frame measured with a ruler, by eye.
SYSTEMATIC_SIGMAS = np.array([0.03, 0.05, 0.01, 0.05, 0.05, 0.03])
# Variance before any driving of the errors of single motions, relative to their length or turn, or radians per metre
# squared. Origin: chosen, a centimetre or a degree in a motion of a decimetre or ten degrees.
INITIAL_SPREAD = 0.1**2
# Radians squared per metre: variance before any driving of the error of the heading. Origin: definition, that of
# motions of a decimetre.
INITIAL_WALK = 0.1 * INITIAL_SPREAD
# Factor by which odometry may over- or underestimate turns; beyond, the wheels are faulty rather than miscalibrated.
# Origin: chosen, well beyond calibration errors; not measured.
MAX_TURN_FACTOR = 2.0


@immutable
class SystematicErrors:
    """Systematic errors of wheel odometry, see the module.

    length, turning  factors of the length and of the turn of a measured motion
    veer             radians per metre that a motion turns in addition
    frame            [x, y, heading] of odometry's frame in the base's frame
    variances        (6,) of all these
    """

    length: float = 1.0
    turning: float = 1.0
    veer: float = 0.0
    frame: se2.Pose = field(default_factory=lambda: np.zeros(3))
    variances: Floats = field(default_factory=lambda: SYSTEMATIC_SIGMAS**2)

    @classmethod
    def of_samples(cls, samples: Floats, expected: Floats = PERFECT) -> SystematicErrors:
        """Estimate the errors from `samples` (n, 8) of motions, see `OdometryModel.samples`.

        `expected` are their values (6,) before the drive, with SYSTEMATIC_SIGMAS.
        """
        means, variances = _systematic_errors(samples, expected - PERFECT)
        turning = min(max(1.0 + means[1], 1 / MAX_TURN_FACTOR), MAX_TURN_FACTOR)
        return cls(1.0 + means[0], turning, means[2], means[3:], variances)

    @property
    def values(self) -> Floats:
        """(6,) length, turning, veer and frame; (1, 1, 0, 0, 0, 0) for perfect odometry."""
        return np.array([self.length, self.turning, self.veer, *self.frame])

    def correct(self, motion: se2.Pose) -> se2.Pose:
        """Return measured motions (..., 3) of odometry's frame as motions of the base, without systematic errors."""
        rows = np.ascontiguousarray(motion).reshape(-1, 3)
        corrected = corrected_motions(rows, self.length, self.turning, self.veer, self.frame)
        return np.asarray(corrected).reshape(motion.shape)


@compiled
def _systematic_errors(samples, expected):  # type: ignore[no-untyped-def]
    """Return means (6,) and variances (6,) of the errors of length, turning and veering, and of odometry's frame.

    samples   (n, 8) motions as measured by odometry and as registered, with variances
    expected  (6,) means before the drive

    A motion that turns by t moves the base by (I - R(t)) p in addition if odometry's frame is at p. In the axes halfway
    between both ends this is 2 sin(t / 2) [p_y, -p_x].
    """
    count = len(samples)
    means, variances = np.empty(6), np.empty(6)
    turning = np.array([1.0 + expected[1], expected[2]])
    turning, variances[1:3] = heading_errors(samples, turning, SYSTEMATIC_SIGMAS[1:3], INITIAL_WALK, PRIOR_SAMPLES)
    means[1], means[2] = turning[0] - 1.0, turning[1]
    length, skew, straight = np.empty(count), np.empty(count), 0
    for k in range(count):
        ahead, left, turn = samples[k, 0], samples[k, 1], samples[k, 2]
        if abs(ahead) > MIN_MOTION_TRAVEL and not is_turn(turn, samples[k, 5]):
            extra = wrap_angle(samples[k, 5] - turn)
            length[straight] = samples[k, 3] / ahead - 1.0
            skew[straight] = (samples[k, 4] - left) / ahead - 0.5 * extra  # an arc's chord points ahead by half a turn
            straight += 1
    means[0], variances[0] = _posterior(length[:straight], expected[0], SYSTEMATIC_SIGMAS[0])
    means[5], variances[5] = _posterior(skew[:straight], expected[5], SYSTEMATIC_SIGMAS[5])
    x, y, turns = np.empty(count), np.empty(count), 0
    for k in range(count):
        turn, actual = samples[k, 2], samples[k, 5]
        if is_turn(turn, actual):
            half, scale = 0.5 * actual, (1.0 + means[0])
            c, s = math.cos(half), math.sin(half)
            ahead, left = c * samples[k, 3] + s * samples[k, 4], c * samples[k, 4] - s * samples[k, 3]
            bend = means[5] - 0.5 * turn  # of the measured chord in the axes halfway
            c, s = math.cos(bend), math.sin(bend)
            ahead -= scale * (c * samples[k, 0] - s * samples[k, 1])
            left -= scale * (c * samples[k, 1] + s * samples[k, 0])
            change = 2.0 * math.sin(0.5 * turn)  # by the measured turn: that of registration may be zero
            x[turns], y[turns] = -left / change, ahead / change
            turns += 1
    means[3], variances[3] = _posterior(x[:turns], expected[3], SYSTEMATIC_SIGMAS[3])
    means[4], variances[4] = _posterior(y[:turns], expected[4], SYSTEMATIC_SIGMAS[4])
    return means, variances


@compiled
def _posterior(values, expected, sigma):  # type: ignore[no-untyped-def]
    """Return mean and variance of an error, from samples (n,), and its mean and standard deviation before them.

    The samples count by their median, whose variance is pi / 2 times that of a mean. The spread of few samples says
    little about their variance: before any driving it is INITIAL_SPREAD, which counts for PRIOR_SAMPLES.
    """
    count = len(values)
    if not count:
        return expected, sigma**2
    middle = median(values)
    spread = median((values - middle) ** 2) / NORMAL_MEDIAN
    spread = (PRIOR_SAMPLES * INITIAL_SPREAD + count * spread) / (PRIOR_SAMPLES + count)
    share = sigma**2 / (sigma**2 + 0.5 * math.pi * spread / count)
    return expected + share * (middle - expected), (1.0 - share) * sigma**2

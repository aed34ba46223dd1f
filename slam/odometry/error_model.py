"""Error model of wheel odometry: systematic errors, which are corrected, and random errors, which give covariances."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..config import OdometryConfig
from ..geometry.angles import wrap_angle
from ..geometry.degeneracy import weakest_direction
from ..geometry.segments import Floats
from ..geometry.small_matrices import inverse
from .arc import with_turn
from .history import wheel_travel

# Metres of wheel travel below which a motion is not used: its difference from registration is mostly registration's
# error. Origin: chosen, above the accuracy of registration; not measured.
MIN_MOTION_TRAVEL = 0.05
# Latest motions from which the random errors are estimated. Origin: chosen, some 60 m of driving; not measured.
RANDOM_ERROR_SAMPLES = 200
# Latest motions from which the systematic errors are estimated. Origin: chosen, more than for the random errors, as
# they change less; not measured.
MAX_MOTION_SAMPLES = 500
# Motions that the configured values count for, in a geometric mean: they may be wrong by a factor, and with an
# arithmetic mean a value five times too large would dominate even after a hundred motions.
# Origin: chosen, so few that the first metres of driving correct a wrong value; not measured.
PRIOR_SAMPLES = 10
# Standard deviations of the systematic errors before any driving: relative ones of length and of turning, and veering
# in radians per metre. Origin: chosen, wheels within 3 % of their nominal size and distance, that differ by 0.5 % at a
# distance of half a metre.
SYSTEMATIC_SIGMAS = np.array([0.03, 0.05, 0.01])
# Variance before any driving of the errors of single motions, relative to their length or turn, or radians per metre
# squared. Origin: chosen, a centimetre or a degree in a motion of a decimetre or ten degrees.
INITIAL_SPREAD = 0.1**2
# Smallest variance of the random errors, square metres or square radians per metre: no wheels err by less than 0.1 mm
# or 0.1 mrad in a metre. Origin: chosen, far below real wheels; not measured.
MIN_VARIANCE_RATE = 1e-8
# Metres: motions are not used for learning if the standard deviation of registration exceeds this in some direction.
# Origin: chosen, about the odometry error of one motion; not measured.
MAX_LEARNING_SIGMA = 0.05
# Metres: drift is correlated in a direction in which the standard deviation of registration exceeds this.
# Origin: chosen, worse than odometry over some metres; not measured.
UNOBSERVED_SIGMA = 0.3
# Metres of travel over which odometry errors are taken as equal, e.g. those of a wrong wheel diameter. This matters
# only if many motions in a row are not corrected by registration.
# Origin: chosen, the length of a corridor; not measured.
CORRELATION_LENGTH = 20.0
# Factor by which odometry may over- or underestimate turns; beyond, the wheels are faulty rather than miscalibrated.
# Origin: chosen, well beyond calibration errors; not measured.
MAX_TURN_FACTOR = 2.0
# Radians: a motion that turns by less is used for the factor of length and for veering, else for the factor of turning.
# Origin: chosen, several times the heading error of registration; not measured.
MAX_STRAIGHT_TURN = math.radians(4.0)
# Variance of the middle of a parabola fitted to a random walk with the variance 1 at both ends, and 0 in the middle.
# Origin: definition, 2 int_0^1 (int_x^1 w)^2 dx with the weights w(u) = (9 - 15 u^2) / 8 of the fit.
PARABOLA_VARIANCE = 9.0 / 112.0
# Median of a squared standard normal variable. Origin: definition, chi-square, 1 dof.
NORMAL_MEDIAN = 0.4549
# Median of the sum of two squared standard normal variables. Origin: definition, chi-square, 2 dof.
PLANE_MEDIAN = 1.3863
# Relative standard errors of the medians of these squares, times the root of their number: 1 / (2 f(m) m) with the
# median m and the density f. Origin: definition, chi-square, 1 and 2 dof.
NORMAL_MEDIAN_ERROR = 2.33
PLANE_MEDIAN_ERROR = 1.44  # Origin: as NORMAL_MEDIAN_ERROR.


class OdometryModel:
    """Errors of wheel odometry, learned by comparing its motions between keyframes with registration.

    Systematic errors are common to all motions: wrong wheel diameters scale the length of a motion by a factor, a wrong
    distance between the wheels scales turns by another, and unequal wheels veer in proportion to the length. The rest
    is random: the standard deviation of translation is proportional to the travel, heading is a random walk. All
    estimates are medians, which single gross errors do not affect; in the graph, the robust kernel of odometry factors
    limits them.
    """

    measured = True
    """False if the motions are predicted, see `PredictedMotionModel`."""
    unobserved_sigma = UNOBSERVED_SIGMA
    """Metres: scans do not determine the position in a direction in which their standard deviation exceeds this."""

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self._floors = np.array([config.translation_floor, config.rotation_floor])
        self._initial_rates = np.array([config.translation_error**2, config.rotation_walk**2])
        self._samples: Floats = np.zeros((0, 8))
        self._rates = self._initial_rates
        self._length_factor = self._turn_factor = 1.0
        self._veer = 0.0  # radians per metre
        self._systematic_variances = SYSTEMATIC_SIGMAS**2  # of length, turning and veering

    @property
    def deviations(self) -> Floats:
        """(2,) standard deviations after one metre of travel, of translation (metres) and heading (radians)."""
        return np.asarray(np.sqrt(self._rates))

    @property
    def systematic_errors(self) -> Floats:
        """(3,) factor of length, factor of turning, and veering in radians per metre; (1, 1, 0) for perfect wheels."""
        return np.array([self._length_factor, self._turn_factor, self._veer])

    @property
    def floors(self) -> Floats:
        """(2,) standard deviations of a single reading, of position (metres) and heading (radians)."""
        return self._floors

    @property
    def samples(self) -> Floats:
        """(n, 8) motions as measured by odometry and as registered, from which the model is estimated.

        With the variances of the registered ones: of the position in one direction (square metres), and of the heading.
        """
        return self._samples

    def add_samples(self, samples: Floats) -> None:
        """Add `samples` (n, 8), e.g. of a saved model, and estimate the model again."""
        self._samples = np.concatenate([self._samples, samples])[-MAX_MOTION_SAMPLES:]
        self._estimate()

    def add_motion(self, measured: se2.Pose, registered: se2.Pose, information: Floats) -> None:
        """Learn from a motion [x, y, heading] as measured by odometry and as registered by the scans alone.

        The registered motion must not contain odometry's: the errors learned before would confirm themselves.
        `information` (3, 3) is that of the registration at its end. If it leaves a direction undetermined, as along a
        bare corridor, the motion is not used.
        """
        if not self._config.learn or wheel_travel(measured) < MIN_MOTION_TRAVEL:
            return
        if weakest_direction(registered, information, MAX_LEARNING_SIGMA) is None:
            variances = np.asarray(inverse(information)).diagonal()
            of_position = 0.5 * (variances[0] + variances[1])
            self.add_samples(np.array([[*measured, *registered, of_position, variances[2]]]))

    def _estimate(self) -> None:
        length, veer, turn = _systematic_errors(self._samples)
        self._length_factor, self._veer = 1.0 + length[0], veer[0]
        self._turn_factor = min(max(1.0 + turn[0], 1 / MAX_TURN_FACTOR), MAX_TURN_FACTOR)
        self._systematic_variances = np.array([length[1], turn[1], veer[1]])
        self._estimate_rates(*self._latest_samples())

    def _latest_samples(self) -> tuple[Floats, Floats, Floats]:
        """Return the latest motions as measured (n, 3) and as registered (n, 3), with the variances (n, 2) of these."""
        latest = self._samples[-RANDOM_ERROR_SAMPLES:]
        return latest[:, :3], latest[:, 3:6], latest[:, 6:]

    def _estimate_rates(self, measured: Floats, registered: Floats, variances: Floats) -> None:
        """Estimate the variances of the random errors that remain after correction, without those of registration."""
        observed = np.full(2, MIN_VARIANCE_RATE)
        if len(measured):
            rates = _random_rates(self.correct(measured), registered, variances, wheel_travel(measured))
            observed = np.maximum(rates, MIN_VARIANCE_RATE)
        weight = len(measured) / (len(measured) + PRIOR_SAMPLES)
        self._rates = np.maximum(self._initial_rates, MIN_VARIANCE_RATE) ** (1 - weight) * observed**weight

    def correct(self, motion: se2.Pose) -> se2.Pose:
        """Return measured motions (..., 3) without their systematic errors."""
        turn = self._turn_factor * motion[..., 2] + self._veer * motion[..., 0]
        scaled = self._length_factor * motion
        scaled[..., 2] = motion[..., 2]
        return with_turn(scaled, turn)

    def variances(self, travel: Floats) -> tuple[Floats, Floats]:
        """Return the variances (...,) of translation along each axis and of heading after `travel` metres (...,)."""
        return self._rates[0] * travel**2, self._rates[1] * travel

    def deviations_of_fit(self, travel: float) -> Floats:
        """Return (3,) the standard deviations of the middle of a parabola fitted to `travel` metres to both sides.

        Metres, metres, radians, relative to the pose in the middle. That of a random walk to both ends has 9/112 of the
        variance at an end; errors of position, which are proportional to the travel, cancel.
        """
        return np.array([0.0, 0.0, math.sqrt(PARABOLA_VARIANCE * float(self.variances(np.array(travel))[1]))])

    def covariance(self, motion: se2.Pose) -> Floats:
        """Return (3, 3) the covariance of a corrected motion [x, y, heading] between two readings, in its end frame.

        An error of heading that is made at a share s of the way turns the rest of the motion m. As a random walk it
        moves the end by the integral of (1 - s) |m| across the motion: the variance is |m|^2 / 3 times that of the
        heading. A systematic error grows in proportion to s, and moves the end by |m| / 2 times that of the heading.
        """
        travel = wheel_travel(motion)
        translation, rotation = self.variances(travel)
        ahead, left, turn = motion.tolist()
        c, s = math.cos(turn), math.sin(turn)
        x, y = c * ahead + s * left, c * left - s * ahead  # in the end frame
        length, turning, veering = self._systematic_variances.tolist()
        constant = turning * turn**2 + veering * ahead**2
        own = translation + self._floors[0] ** 2
        bending, mixed = rotation / 3.0 + constant / 4.0, 0.5 * (rotation + constant)
        of_xy = length * (x * y) - bending * (x * y)
        return np.array(
            [
                [own + length * (x * x) + bending * (y * y), of_xy, -mixed * y],
                [of_xy, own + length * (y * y) + bending * (x * x), mixed * x],
                [-mixed * y, mixed * x, rotation + constant + self._floors[1] ** 2],
            ]
        )

    def limit_information(self, information: Floats, travel: float) -> Floats:
        """Return the information (3, 3) of a pose from the points of a scan, limited by the motion during its sweep.

        information  with the noise of the points only
        travel       metres from the middle of a sweep to its ends

        The mean over a random walk to both ends has a sixth of the variance at an end; relative to the fitted reference
        of the sweep it has less.
        """
        if not travel:
            return information
        translation, rotation = self.variances(np.array(travel))
        precision = np.diag(6.0 / np.array([translation, translation, rotation]))
        return np.asarray(information - information @ inverse(information + precision) @ information)

    def correlated_drift(self, motion: se2.Pose, information: Floats) -> Floats:
        """Return (2, 2) the position covariance that a motion adds by errors shared with neighbouring motions.

        In the frame of the motion's end. It is zero except along the direction that the registration at the end, with
        its `information` (3, 3), leaves undetermined. With errors constant over CORRELATION_LENGTH, n motions of travel
        s each must add up to rate (n s) CORRELATION_LENGTH.
        """
        direction = weakest_direction(np.zeros(3), information, self.unobserved_sigma)
        if direction is None:
            return np.zeros((2, 2))
        along = np.array([math.cos(direction), math.sin(direction)])
        return np.asarray(self._shared_rate * wheel_travel(motion) * np.outer(along, along))

    @property
    def _shared_rate(self) -> float:
        """Variance of position per metre by errors that neighbouring motions share, square metres."""
        return float(self._rates[0]) * CORRELATION_LENGTH


@compiled
def _systematic_errors(samples):  # type: ignore[no-untyped-def]
    """Return mean and variance of the errors of length, of veering and of turning.

    samples  (n, 8) motions as measured by odometry and as registered, with variances
    """
    count = len(samples)
    length, veer, straight = np.empty(count), np.empty(count), 0
    for k in range(count):
        ahead = samples[k, 0]
        # Selected by the measured turn, as keyframes are by measured motions: so errors of registration select nothing.
        if abs(ahead) > MIN_MOTION_TRAVEL and abs(samples[k, 2]) <= MAX_STRAIGHT_TURN:
            length[straight] = samples[k, 3] / ahead - 1.0
            veer[straight] = wrap_angle(samples[k, 5] - samples[k, 2]) / ahead
            straight += 1
    of_length = _posterior(length[:straight], SYSTEMATIC_SIGMAS[0])
    of_veer = _posterior(veer[:straight], SYSTEMATIC_SIGMAS[2])
    turn, turning = np.empty(count), 0
    for k in range(count):
        if abs(samples[k, 2]) > MAX_STRAIGHT_TURN:
            turn[turning] = wrap_angle(samples[k, 5] - of_veer[0] * samples[k, 0]) / samples[k, 2] - 1.0
            turning += 1
    return of_length, of_veer, _posterior(turn[:turning], SYSTEMATIC_SIGMAS[1])


@compiled
def _random_rates(corrected, registered, variances, travel):  # type: ignore[no-untyped-def]
    """Return (2,) the variances of position per square metre and of heading per metre, from n motions.

    They are at least the standard errors of their estimates: less cannot be told from the noise of registration.

    corrected   (n, 3) as measured, without their systematic errors
    registered  (n, 3)
    variances   (n, 2) of the registered motions: of the position in one direction, and of the heading
    travel      (n,) metres of wheel travel
    """
    count = len(travel)
    position, heading = np.empty(count), np.empty(count)
    of_position, of_heading = np.empty(count), np.empty(count)  # without the share of registration
    for k in range(count):
        x, y = registered[k, 0] - corrected[k, 0], registered[k, 1] - corrected[k, 1]
        position[k] = (x * x + y * y) / (PLANE_MEDIAN * travel[k] ** 2)
        heading[k] = wrap_angle(registered[k, 2] - corrected[k, 2]) ** 2 / (NORMAL_MEDIAN * travel[k])
        of_position[k] = position[k] - variances[k, 0] / travel[k] ** 2
        of_heading[k] = heading[k] - variances[k, 1] / travel[k]
    least_position = PLANE_MEDIAN_ERROR / math.sqrt(count) * np.median(position)
    least_heading = NORMAL_MEDIAN_ERROR / math.sqrt(count) * np.median(heading)
    return np.array([max(np.median(of_position), least_position), max(np.median(of_heading), least_heading)])


@compiled
def _posterior(values, sigma):  # type: ignore[no-untyped-def]
    """Return mean and variance of an error, from samples (n,) and the standard deviation `sigma` before them.

    The samples count by their median, whose variance is pi / 2 times that of a mean. The spread of few samples says
    little about their variance: before any driving it is INITIAL_SPREAD, which counts for PRIOR_SAMPLES.
    """
    count = len(values)
    if not count:
        return 0.0, sigma**2
    median = np.median(values)
    spread = np.median((values - median) ** 2) / NORMAL_MEDIAN
    spread = (PRIOR_SAMPLES * INITIAL_SPREAD + count * spread) / (PRIOR_SAMPLES + count)
    share = sigma**2 / (sigma**2 + 0.5 * math.pi * spread / count)
    return share * median, (1.0 - share) * sigma**2

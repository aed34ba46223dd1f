"""Error model of wheel odometry: systematic errors, which are corrected, and random errors, which give covariances."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.small_matrices import inverse

from ..config import OdometryConfig
from ..geometry.degeneracy import weakest_direction
from ..geometry.segments import Floats
from ..geometry.surroundings import CORRIDOR_LENGTH
from .history import MIN_MOTION_TRAVEL, Paths, wheel_travel
from .path_errors import (
    motion_along,
    motion_and_covariance,
    motions_along,
    motions_and_covariances,
    path_covariance,
)
from .random_errors import MIN_VARIANCE_RATE, TURN_WALK, estimate_rates
from .systematic_errors import PERFECT, SystematicErrors

# Latest motions from which the random errors are estimated. Origin: chosen, some 60 m of driving; not measured.
RANDOM_ERROR_SAMPLES = 200
# Latest motions from which the systematic errors are estimated. Origin: chosen, more than for the random errors, as
# they change less; not measured.
MAX_MOTION_SAMPLES = 500
# Metres: motions are not used for learning if the standard deviation of registration exceeds this in some direction.
# Origin: chosen, about the odometry error of one motion; not measured.
MAX_LEARNING_SIGMA = 0.05
# Metres: drift is correlated in a direction in which the standard deviation of registration exceeds this.
# Origin: chosen, worse than odometry over some metres; not measured.
UNOBSERVED_SIGMA = 0.3
# Metres of travel over which odometry errors are taken as equal, e.g. those of a wrong wheel diameter. This matters
# only if many motions in a row are not corrected by registration.
# Origin: definition.
CORRELATION_LENGTH = CORRIDOR_LENGTH
# Variance of the middle of a parabola fitted to a random walk with the variance 1 at both ends, and 0 in the middle.
# Origin: definition, 2 int_0^1 (int_x^1 w)^2 dx with the weights w(u) = (9 - 15 u^2) / 8 of the fit.
PARABOLA_VARIANCE = 9.0 / 112.0


class OdometryModel:
    """Errors of wheel odometry, learned by comparing its motions between keyframes with registration.

    Systematic errors are common to all motions, and are corrected. The rest is random: the standard deviations of the
    position along and across a motion are proportional to the travel, and heading is a random walk with the travel and
    with the angle turned. All estimates are medians, which single gross errors do not affect.
    """

    measured = True
    """False if the motions are predicted, see `PredictedMotionModel`."""
    unobserved_sigma = UNOBSERVED_SIGMA
    """Metres: scans do not determine the position in a direction in which their standard deviation exceeds this."""

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self._floors = np.array([config.translation_floor, config.rotation_floor])
        along, heading = config.translation_error**2, config.rotation_walk**2
        self._initial_rates = np.array([along, along, heading, TURN_WALK**2])
        self._samples: Floats = np.zeros((0, 8))
        self._rates = np.maximum(self._initial_rates, MIN_VARIANCE_RATE)
        self._expected, self._systematic = PERFECT, SystematicErrors()

    @property
    def deviations(self) -> Floats:
        """(4,) standard deviations of the random errors.

        Of the position along and across a motion of one metre, metres, and of the heading after a motion of one metre
        and after a turn of one radian, radians.
        """
        return np.asarray(np.sqrt(self._rates))

    @property
    def systematic_errors(self) -> SystematicErrors:
        """Estimate of the systematic errors."""
        return self._systematic

    @property
    def expected_errors(self) -> Floats:
        """(6,) systematic errors that were expected before this drive, see `SystematicErrors.values`."""
        return self._expected

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

    def restore(self, samples: Floats, expected_errors: Floats) -> None:
        """Restore a saved model without samples yet from `samples` (n, 8) and the errors (6,) expected before them."""
        self._expected = expected_errors
        self.add_samples(samples)

    def begin_drive(self) -> None:
        """Begin another drive: the systematic errors learned so far become the mean of the prior.

        Its variances are those before any driving, as tyres, load, floor or the robot may have changed. The random
        errors are learned anew.
        """
        self._expected, self._samples = self._systematic.values, np.zeros((0, 8))
        self._estimate()

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
        self._systematic = SystematicErrors.of_samples(self._samples, self._expected)
        self._estimate_rates(*self._latest_samples())

    def _latest_samples(self) -> tuple[Floats, Floats, Floats]:
        """Return the latest motions as measured (n, 3) and as registered (n, 3), with the variances (n, 2) of these."""
        latest = self._samples[-RANDOM_ERROR_SAMPLES:]
        return latest[:, :3], latest[:, 3:6], latest[:, 6:]

    def _estimate_rates(self, measured: Floats, registered: Floats, variances: Floats) -> None:
        """Estimate the variances of the random errors that remain after correction, without those of registration."""
        corrected, travel = self.correct(measured), wheel_travel(measured)
        self._rates = estimate_rates(self._initial_rates, corrected, registered, variances, travel, self._floors)

    def correct(self, motion: se2.Pose) -> se2.Pose:
        """Return measured motions (..., 3) as motions of the base, without their systematic errors."""
        return self._systematic.correct(motion)

    def motion_along(self, poses: Floats) -> se2.Pose:
        """Return the motion [x, y, heading] of the base along a path of measured poses (n, 3)."""
        errors = self._systematic
        return np.asarray(motion_along(poses, errors.length, errors.turning, errors.veer, errors.frame))

    def motion_and_covariance(self, poses: Floats) -> tuple[se2.Pose, Floats]:
        """Return the motion along a path of measured poses (n, 3), and its covariance (3, 3), in its end frame."""
        errors = self._systematic
        motion, covariance = motion_and_covariance(
            poses, errors.length, errors.turning, errors.veer, errors.frame,
            self._rates, self._floors, errors.variances, CORRELATION_LENGTH,
        )  # fmt: skip
        return motion, covariance

    def motions_along(self, poses: Floats, paths: Paths) -> Floats:
        """Return the motions (n - 1, 3) from each of measured poses (n, 3) to the next one along their paths."""
        errors = self._systematic
        return np.asarray(motions_along(poses, *paths, errors.length, errors.turning, errors.veer, errors.frame))

    def motions_and_covariances(self, poses: Floats, paths: Paths) -> tuple[Floats, Floats]:
        """Return the same motions, and their covariances (n - 1, 3, 3), in their end frames."""
        errors = self._systematic
        motions, covariances = motions_and_covariances(
            poses, *paths, errors.length, errors.turning, errors.veer, errors.frame,
            self._rates, self._floors, errors.variances, CORRELATION_LENGTH,
        )  # fmt: skip
        return motions, covariances

    def variances(self, travel: Floats) -> tuple[Floats, Floats]:
        """Return the variances (...,) of translation along each axis and of heading after `travel` metres (...,)."""
        return self._rates[0] * travel**2, self._rates[2] * travel

    def deviations_of_fit(self, travel: float) -> Floats:
        """Return (3,) the standard deviations of the middle of a parabola fitted to `travel` metres to both sides.

        Metres, metres, radians, relative to the pose in the middle. That of a random walk to both ends has 9/112 of the
        variance at an end; errors of position, which are proportional to the travel, cancel.
        """
        return np.array([0.0, 0.0, math.sqrt(PARABOLA_VARIANCE * float(self.variances(np.array(travel))[1]))])

    def covariance(self, motion: se2.Pose) -> Floats:
        """Return (3, 3) the covariance of a corrected motion [x, y, heading] between two readings, in its end frame."""
        path, errors, length = np.stack([np.zeros(3), motion]), self._systematic, CORRELATION_LENGTH
        return np.asarray(path_covariance(path, self._rates, self._floors, errors.variances, errors.turning, length))

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

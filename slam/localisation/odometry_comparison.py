"""Comparison of odometry with the scans, over motions that are long enough to tell whether odometry is failing.

A slip of the wheels, a late reading or a jump contradicts the scans for a moment. Odometry that stands still, also as
the robot is pushed, and that of a broken encoder contradict them in each motion. After the time for which a robot keeps
its velocity, odometry is not used any more, until it agrees with the scans over such a motion.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.small_matrices import inverse
from features.normal_limits import GROSS_LIMIT, NORMAL_LIMIT

from ..geometry.segments import Floats
from ..geometry.significance import MOST
from ..matching.point_matcher import Prediction
from ..odometry.dead_reckoning import DeadReckoning
from ..odometry.history import wheel_travel
from ..odometry.velocity import STEADY_SECONDS, VelocityFilter
from .prediction_error import PREDICTION_SIGMAS
from .tracking import CONDITIONING, PoseFix

# Metres of wheel travel, by odometry or by the scans, over which they are compared. Origin: definition, five times the
# usual error of a pose, so that gross errors show.
COMPARED_TRAVEL = GROSS_LIMIT * float(PREDICTION_SIGMAS[0])
# Share of its motion by which odometry must be wrong to be called slipping or standing still. Origin: definition,
# most of it: errors of calibration and ordinary slip are far below.
GROSS_SHARE = MOST
# Seconds of a comparison that count at most: a slip after a stop is one comparison, and does not last.
# Origin: definition, it takes two comparisons at least.
MAX_COMPARED_SECONDS = 0.5 * STEADY_SECONDS


@immutable
class ComparedFix:
    """Fix of a tracked scan, with what the scans say about the motion there.

    information  (3, 3) of the fix, by the scan alone
    velocity     at the fix
    seconds      since the fix before; zero if it does not count
    """

    fix: PoseFix
    information: Floats
    velocity: VelocityFilter
    seconds: float


class OdometryComparison:
    """How long odometry has contradicted the scans without a break.

    contradicted_for  seconds, of moving
    """

    def __init__(self, contradicted_for: float = 0.0) -> None:
        self.contradicted_for = contradicted_for
        self._start: PoseFix | None = None  # of the present comparison; None before the next fix
        self._velocity = VelocityFilter()  # at the start
        self._seconds = 0.0  # since then
        self._undetermined = 0.0  # seconds in which neither the scans nor a contradiction told if odometry fails

    @property
    def failing(self) -> bool:
        """True if odometry has contradicted the scans for STEADY_SECONDS, and has not agreed with them since then."""
        return self.contradicted_for >= STEADY_SECONDS

    def stop_odometry(self) -> None:
        """Take odometry as failing, as its readings have stopped."""
        self.contradicted_for = max(self.contradicted_for, STEADY_SECONDS)

    def add_slip(self, seconds: float) -> None:
        """Count the time (seconds) of a slip that the scans have shown, and compare from the next fix on."""
        self.contradicted_for += seconds
        self.restart()

    def restart(self) -> None:
        """Compare from the next fix on: the motion up to there is not known."""
        self._start = None

    def follow(self, correction: se2.Pose, fix: PoseFix) -> None:
        """Move the start of the comparison with the last `fix`, which was moved by `correction` in its own frame."""
        if self._start is not None:
            relative = se2.between(fix.pose, self._start.pose)
            self._start = PoseFix(se2.compose(se2.compose(fix.pose, correction), relative), self._start.odometry)

    def add(
        self,
        compared: ComparedFix,
        dead_reckoning: DeadReckoning,
        prediction_error: Floats,
        is_certain: Callable[[Prediction], bool],
    ) -> None:
        """Add the fix of a tracked scan.

        The comparison continues until a gross error of the motion would be significant, given the errors of
        predictions. If it is not significant with those of the scans, as in a bare corridor, the scans do not determine
        the motion. After STEADY_SECONDS of that, odometry is used again: a robot may have any velocity by then. A
        contradiction counts if it is certain, and if the robot moves evenly by the scans.

        dead_reckoning    that is compared
        prediction_error  (3, 3) covariance of predictions besides that of odometry
        is_certain        returns True if a contradiction between the scan and a prediction by odometry is certain
        """
        fix = compared.fix
        if self._start is None:
            self._begin(fix, compared.velocity)
            return
        self._seconds += compared.seconds
        motion, covariance = dead_reckoning.motion_and_covariance(self._start.odometry, fix.odometry)
        by_scans = se2.between(self._start.pose, fix.pose)
        if max(wheel_travel(motion), wheel_travel(by_scans)) < COMPARED_TRAVEL:
            return
        gross = GROSS_SHARE * max(motion, by_scans, key=wheel_travel)
        error = covariance + prediction_error
        if not _is_significant(gross, inverse(error)):
            return
        by_scan = np.asarray(inverse(compared.information + CONDITIONING))
        self._compare(by_scans, motion, gross, error + 2.0 * by_scan, is_certain)
        self._begin(fix, compared.velocity)

    def _begin(self, fix: PoseFix, velocity: VelocityFilter) -> None:
        """Begin a comparison at a fix."""
        self._start, self._velocity, self._seconds = fix, velocity.copy(), 0.0

    def _compare(
        self,
        by_scans: se2.Pose,
        motion: se2.Pose,
        gross: se2.Pose,
        error: Floats,
        is_certain: Callable[[Prediction], bool],
    ) -> None:
        """Compare a motion by the scans with that by odometry.

        gross  error of the motion, metres and radians
        error  (3, 3) covariance of the difference of both motions
        """
        assert self._start is not None
        difference = se2.between(motion, by_scans)
        information = inverse(error)
        contradicts = wheel_travel(difference) > wheel_travel(gross) and _is_significant(difference, information)
        if not _is_significant(gross, information):
            self._undetermined = 0.0 if contradicts else self._undetermined + self._seconds
            if self._undetermined > STEADY_SECONDS:
                self.contradicted_for = 0.0
            return
        self._undetermined = 0.0
        if not contradicts:
            self.contradicted_for = 0.0
        elif self._is_even(by_scans) and is_certain(Prediction(se2.compose(self._start.pose, motion), information)):
            self.contradicted_for += min(self._seconds, MAX_COMPARED_SECONDS)

    def _is_even(self, motion: se2.Pose) -> bool:
        """Return True if a motion since the start of the comparison continues the one before."""
        sigmas = self._velocity.deviations(self._seconds) + PREDICTION_SIGMAS
        change = se2.between(self._velocity.motion(self._seconds), motion)
        return not _is_significant(change, inverse(np.diag(sigmas**2)))


def _is_significant(difference: se2.Pose, information: Floats) -> bool:
    """Return True if a difference of two motions is larger than its `information` (3, 3) explains."""
    return bool(difference @ information @ difference > NORMAL_LIMIT**2)

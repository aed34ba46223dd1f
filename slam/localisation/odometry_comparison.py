"""Comparison of odometry with the scans, over motions that are long enough to tell whether odometry is failing.

A slip of the wheels, a late reading or a jump contradicts the scans for a moment. Odometry that stands still, also as
the robot is pushed, and that of a broken encoder contradict them in each motion. After the time for which a robot keeps
its velocity, odometry is not used any more, until it agrees with the scans over such a motion.
"""

from __future__ import annotations

from drivers import se2

from ..geometry.segments import Floats
from ..geometry.small_matrices import inverse
from ..matching.point_matcher import Prediction
from ..odometry.error_model import OdometryModel
from ..odometry.history import wheel_travel
from ..odometry.velocity import ACCELERATIONS, MAX_VELOCITIES
from .tracking import PoseFix

# Seconds for which a robot moves evenly: after that time it may have any velocity.
# Origin: definition, the time in which ACCELERATIONS lead to MAX_VELOCITIES.
STEADY_SECONDS = float((MAX_VELOCITIES / ACCELERATIONS).min())
# Metres of wheel travel, by odometry or by the scans, over which they are compared. Origin: chosen, five times the
# usual error of a pose and a reading; not measured.
COMPARED_TRAVEL = 0.1
# Share of its motion by which odometry must be wrong to be called slipping or standing still. Origin: chosen; errors of
# calibration and ordinary slip are far below.
GROSS_SHARE = 0.5
# Seconds of a comparison that count at most: a slip after a stop is one comparison, and does not last.
# Origin: definition, it takes two comparisons at least.
MAX_COMPARED_SECONDS = 0.5 * STEADY_SECONDS


class OdometryComparison:
    """How long odometry has contradicted the scans without a break.

    contradicted_for  seconds, of moving
    """

    def __init__(self, contradicted_for: float = 0.0) -> None:
        self.contradicted_for = contradicted_for
        self._start: PoseFix | None = None  # of the present comparison; None before the next fix
        self._seconds = 0.0  # since then

    @property
    def failing(self) -> bool:
        """True if odometry has contradicted the scans for STEADY_SECONDS, and has not agreed with them since then."""
        return self.contradicted_for >= STEADY_SECONDS

    def stop_odometry(self) -> None:
        """Take odometry as failing, as its readings have stopped."""
        self.contradicted_for = max(self.contradicted_for, STEADY_SECONDS)

    def restart(self) -> None:
        """Compare from the next fix on: the motion up to there is not known."""
        self._start = None

    def follow(self, correction: se2.Pose, fix: PoseFix) -> None:
        """Move the start of the comparison with the last `fix`, which was moved by `correction` in its own frame."""
        if self._start is not None:
            relative = se2.between(fix.pose, self._start.pose)
            self._start = PoseFix(se2.compose(se2.compose(fix.pose, correction), relative), self._start.odometry)

    def add(
        self, fix: PoseFix, covariance: Floats, seconds: float, model: OdometryModel, prediction_error: Floats
    ) -> None:
        """Add the fix of a tracked scan.

        covariance        (3, 3) of the fix
        seconds           since the fix before; zero if it does not count
        prediction_error  (3, 3) covariance of predictions besides that of the `model`
        """
        if self._start is None:
            self._start, self._seconds = fix, 0.0
            return
        self._seconds += seconds
        by_odometry, by_scans = self._start.odometry_motion(fix.odometry), se2.between(self._start.pose, fix.pose)
        travel = max(wheel_travel(by_odometry), wheel_travel(by_scans))
        if travel < COMPARED_TRAVEL:
            return
        motion = model.correct(by_odometry)
        error = model.covariance(motion) + prediction_error + 2.0 * covariance
        contradicts = wheel_travel(se2.between(motion, by_scans)) > GROSS_SHARE * travel and Prediction(
            motion, inverse(error)
        ).excludes(by_scans)
        seconds = min(self._seconds, MAX_COMPARED_SECONDS)
        self.contradicted_for = self.contradicted_for + seconds if contradicts else 0.0
        self._start, self._seconds = fix, 0.0

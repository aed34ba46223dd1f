"""Predictions of the pose at the next scan: by odometry, after its failure, and from a tentative pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.messages import Odometry
from drivers.small_matrices import inverse
from features.normal_limits import NORMAL_LIMIT

from ..geometry.pose_covariance import covariance_after
from ..geometry.segments import Floats
from ..matching.point_matcher import MAX_SEARCH_SHIFT, PointMatch, Prediction, information_of
from ..odometry.dead_reckoning import DeadReckoning
from ..odometry.history import wheel_travel
from ..odometry.measurement_clock import MIN_PERIOD, MeasurementClock
from ..odometry.velocity import MAX_VELOCITIES, STEADY_SECONDS, VelocityFilter
from .followed_motion import Compare, FollowedMotion
from .match_target import MIN_EVIDENCE
from .odometry_comparison import ComparedFix, OdometryComparison
from .prediction_error import PREDICTION_SIGMAS, PredictionError
from .predictions import Predictions, TentativePose
from .slip_statistics import SlipStatistics
from .small_objects import SmallObjects
from .tracking import CONDITIONING, PoseFix, TrackerState, TrackingResult, TrackingStatus
from .view_change import MAX_TRAVEL


class PosePredictor:
    """Predictions from the last fix on.

    While odometry is failing, each motion is predicted to be even, as without odometry.

    dead_reckoning  of the base; it predicts the motion
    """

    def __init__(self, dead_reckoning: DeadReckoning) -> None:
        self._dead_reckoning = dead_reckoning
        self._fix: PoseFix | None = None
        self._reference: PoseFix | None = None  # from which odometry predicts
        self._tentative: TentativePose | None = None  # of the last scan
        self._before_slip: PoseFix | None = None  # reference before the last slip
        self._since_slip = 0.0  # seconds
        self._interval = 0.0  # seconds between the last two scans
        self._since_fix: float | None = None  # seconds; None if no slip is possible
        self._last_odometry: Odometry | None = None  # at the last scan
        self._odometry_after_gap: Odometry | None = None  # at the first scan since the fix that showed something
        self._clock, self._velocity = MeasurementClock(), VelocityFilter()
        self._prediction_error, self._slips = PredictionError(), SlipStatistics()
        self._comparison = OdometryComparison()
        self._followed: FollowedMotion | None = None  # None before the next fix

    @property
    def fix(self) -> PoseFix | None:
        """Last fix; None before the first scan."""
        return self._fix

    @property
    def tentative(self) -> PoseFix | None:
        """Pose of the last scan if it was tentative, else None."""
        return None if self._tentative is None else self._tentative.fix

    @property
    def measured(self) -> bool:
        """True if odometry measures the motion: there is odometry, and it is not failing."""
        return self._dead_reckoning.model.measured and not self._comparison.failing

    @property
    def odometry_failing(self) -> bool:
        """True if there is odometry, but it is failing, so that the motion is predicted without it."""
        return self._dead_reckoning.model.measured and self._comparison.failing

    def stop_odometry(self) -> None:
        """Take odometry as failing, as its readings have stopped, until it agrees with the scans again."""
        self._comparison.stop_odometry()

    @property
    def interval(self) -> float:
        """Seconds between the last two scans."""
        return self._interval

    @property
    def velocity(self) -> VelocityFilter:
        """Copy of the velocity at the last fix."""
        return self._velocity.copy()

    def move_to(self, pose: se2.Pose, odometry: Odometry) -> None:
        """Set the fix: the base is at `pose` in the map at a reading of odometry."""
        self._fix = self._reference = PoseFix(pose, odometry)
        self._since_fix = None  # no slip is possible before the next fix
        self._tentative = self._before_slip = self._odometry_after_gap = self._followed = None
        self._comparison.restart()

    def start_again(self, pose: se2.Pose, odometry: Odometry) -> None:
        """Set the fix in a new part of the map, which may begin with scans that were tracked before."""
        self.move_to(pose, odometry)
        self._clock.start_again()

    def is_after_gap(self, taken: int, missing: int) -> bool:
        """Return True if scans are missing since the last fix, and the robot may have moved beyond the searched poses.

        taken    scans since the last fix
        missing  number of scans from which on the gap counts
        """
        if not self._since_fix:
            return False
        periods = self._since_fix / max(self._clock.period, MIN_PERIOD)
        if periods < taken + missing:  # most scans: the rest takes longer
            return False
        return NORMAL_LIMIT * float(self._velocity.deviations(self._since_fix)[:2].max()) > MAX_SEARCH_SHIFT

    def stood(self, odometry: Odometry) -> bool:
        """Return True if the wheels hardly moved from the last fix to a later reading: the robot may be carried."""
        if self._fix is None or not self.measured:
            return False
        return bool(wheel_travel(self._dead_reckoning.motion(self._fix.odometry, odometry)) <= MAX_TRAVEL)

    @property
    def stood_in_gap(self) -> bool:
        """True if the wheels hardly moved from the last fix to the first scan since then that shows something."""
        after = self._last_odometry if self._odometry_after_gap is None else self._odometry_after_gap
        return after is not None and self.stood(after)

    @property
    def measured_in_gap(self) -> bool:
        """True if odometry has measured the motion from the last fix to the last scan.

        It has not if the wheels stood, as the robot may have been carried then, or if there was no reading in most of
        that time. Without a history of readings, the two at its ends are taken to measure it.
        """
        if self._fix is None or self._last_odometry is None or not self.measured or self.stood_in_gap:
            return False
        begin, end = self._fix.odometry.stamp, self._last_odometry.stamp
        stamps = self._dead_reckoning.history.stamps
        if not len(stamps):
            return True
        within = stamps[np.searchsorted(stamps, begin) : np.searchsorted(stamps, end, side="right")]
        return float(np.diff(within, prepend=begin, append=end).max()) <= 0.5 * (end - begin)

    def correct(self, pose: se2.Pose, covariance: Floats | None = None) -> None:
        """Replace the pose of the last fix, and predict from it from now on; for the covariance see `PoseFix`."""
        assert self._fix is not None
        self._comparison.follow(se2.between(self._fix.pose, pose), self._fix)
        self._followed = None if self._followed is None else self._followed.moved(self._fix.pose, pose)
        covariance = np.zeros((3, 3)) if covariance is None else covariance
        self._fix = self._reference = PoseFix(pose, self._fix.odometry, covariance)

    def state(self, small_objects: SmallObjects, last_score: float) -> TrackerState | None:
        """Return the state to be saved, with that of the tracker itself; None before the first scan."""
        if self._fix is None or self._reference is None:
            return None
        return TrackerState(
            self._fix, self._reference, self._since_fix, self._clock.last, self._clock.intervals,
            self._velocity.velocity, self._velocity.variances,
            self._prediction_error.variances, self._prediction_error.scans,
            replace(self._slips), replace(small_objects), self._comparison.contradicted_for, last_score,
        )  # fmt: skip

    def restore(self, state: TrackerState) -> None:
        """Continue from a saved state."""
        self._fix, self._reference = state.fix, state.reference
        self._since_fix, self._clock = state.since_fix, MeasurementClock(state.scan_stamp, state.intervals)
        # copied, as saved arrays may be read-only, which would be compiled for separately
        self._velocity = VelocityFilter(np.array(state.velocity), np.array(state.velocity_variances))
        self._prediction_error = PredictionError(np.array(state.prediction_variances), state.prediction_scans)
        self._slips, self._comparison = replace(state.slips), OdometryComparison(state.contradicted_for)
        self._followed = None

    def extrapolate(self, odometry: Odometry) -> se2.Pose:
        """Return the base's pose in the map, by odometry alone since the last fix."""
        if self._fix is None:
            return np.zeros(3)
        return se2.compose(self._fix.pose, self._dead_reckoning.motion(self._fix.odometry, odometry))

    def predict(self, odometry: Odometry) -> Predictions:
        """Return the predictions of the pose at the next scan, given the reading of odometry at its stamp.

        To be called once for each scan: the time since the last fix counts on.
        """
        if self._fix is None or self._reference is None:
            self.move_to(np.zeros(3), odometry)
        self._last_odometry = odometry
        self._interval = interval = self._clock.interval(odometry.stamp)
        self._since_fix = None if self._since_fix is None else self._since_fix + interval
        usual, slip = self._usual_and_slip(odometry, interval)
        followed = self._followed = None if self._followed is None else self._followed.after(interval)
        caught_up: Prediction | None = None
        from_tentative: tuple[Prediction, ...] = ()
        self._since_slip += interval
        if self._before_slip is not None and self._since_slip < STEADY_SECONDS and not self.odometry_failing:
            caught_up = self._by_odometry(self._before_slip, odometry, slip)
        if (tentative := self._tentative) is not None:
            if (other := tentative.alternative) is not None:
                # Both hypotheses are followed from where the last scan fits them.
                start = PoseFix(other.pose, tentative.fix.odometry)
                usual = self._by_odometry(start, odometry, usual.inertia, other.additional_cost)
            if tentative.followed is None:
                even = self._even_motion(tentative.fix.pose, interval)
                from_tentative = (self._by_odometry(tentative.fix, odometry, even), even)
            else:  # odometry has slipped for too long to be right already
                velocity = tentative.followed.velocity
                from_tentative = (self._even_motion(tentative.fix.pose, interval, velocity=velocity),)
        if tentative is None and followed is not None and followed.evidence >= MIN_EVIDENCE:
            slip = followed.prediction(self._slips.cost - followed.evidence)
            return Predictions(usual, slip, followed, caught_up, evidence=followed.evidence)
        evidence = 0.0 if tentative is None else tentative.evidence
        return Predictions(usual, None if self._since_fix is None else slip, None, caught_up, from_tentative, evidence)

    def learn(self, usual: Prediction, match: PointMatch) -> None:
        """Learn the error of predictions from the match of a tracked scan, and its usual prediction."""
        difference, of_match = se2.between(usual.pose, match.pose), inverse(match.information + CONDITIONING)
        self._prediction_error.add(difference, inverse(usual.information), of_match)

    def update(
        self,
        result: TrackingResult,
        odometry: Odometry,
        tentative: TentativePose | None,
        is_certain: Callable[[Prediction], bool],
        compare: Compare,
    ) -> None:
        """Keep the pose of a scan as the fix or as tentative, by its status.

        tentative   pose of the scan if it is TENTATIVE, else None
        is_certain  returns True if a contradiction between the scan and a prediction by odometry is certain
        compare     compares the scan at another prediction, see `FollowedMotion`
        """
        before = self._tentative if result.from_tentative else None
        if tentative is not None and before is not None and tentative.followed is None:
            tentative = replace(tentative, followed=before.followed)
        self._tentative = tentative
        if result.status is TrackingStatus.NO_FEATURES:
            return
        if self._odometry_after_gap is None:
            self._odometry_after_gap = odometry
        if result.status is not TrackingStatus.TRACKED:
            return
        assert self._fix is not None
        fix = PoseFix(result.pose, odometry)
        if before is not None and before.followed is not None:
            # The slip began scans ago: the motion since the last fix is not that of the robot.
            self._velocity = before.followed.velocity.copy()
            self._velocity.correct(se2.between(before.fix.pose, fix.pose), result.registered_covariance, self._interval)
        elif self._since_fix:
            self._velocity.correct(se2.between(self._fix.pose, fix.pose), result.registered_covariance, self._since_fix)
        if result.slipped and self.measured:
            self._before_slip, self._since_slip = self._reference, 0.0
        if result.slipped or not self._dead_reckoning.model.measured:  # odometry continues from here
            self._reference = fix
        if self._dead_reckoning.model.measured:
            # Between scans that are farther apart, an even motion predicts nothing: odometry that fails is better.
            seconds = (self._since_fix or 0.0) if self._interval <= STEADY_SECONDS else 0.0
            compared = ComparedFix(fix, result.registration.total_information, self._velocity, seconds)
            self._comparison.add(compared, self._dead_reckoning, self._prediction_error.covariance, is_certain)
            if before is not None and before.followed is not None:
                self._comparison.add_slip(before.followed.duration)
        self._slips.add(slipped=result.slipped)
        self._fix = fix
        self._since_fix, self._odometry_after_gap = 0.0, None
        self._followed = self._following(compare) if self.measured and not result.slipped else None

    def _following(self, compare: Compare) -> FollowedMotion:
        """Return the hypothesis of a slip after a scan that was tracked by odometry: that so far, or a new one."""
        assert self._fix is not None
        followed = None if self._followed is None else self._followed.compared(self._fix.pose, compare)
        if followed is None or (followed.apart is None and followed.duration > STEADY_SECONDS):
            return FollowedMotion.begin(self._fix.pose, self._velocity)
        return followed

    def _usual_and_slip(self, odometry: Odometry, interval: float) -> tuple[Prediction, Prediction]:
        """Return the prediction by odometry and that after its failure, `interval` seconds after the last scan."""
        assert self._fix is not None
        assert self._reference is not None
        if self.odometry_failing:
            seconds = interval if self._since_fix is None else self._since_fix
            even, uneven = (self._even_motion(self._fix.pose, seconds, cost) for cost in (0.0, SlipStatistics().cost))
            return self._unmeasured(even, uneven, seconds, seconds)
        slip = self._even_motion(self._fix.pose, self._since_fix or 0.0, self._slips.cost)
        if not self._dead_reckoning.model.measured:
            usual = self._by_odometry(self._reference, odometry, None)
            return self._unmeasured(usual, slip, self._since_fix or 0.0, interval)
        inertia = slip if self._since_fix is not None else None
        return self._by_odometry(self._reference, odometry, inertia, self._slips.cost_of_none), slip

    def _unmeasured(
        self, even: Prediction, uneven: Prediction, seconds: float, interval: float
    ) -> tuple[Prediction, Prediction]:
        """Return the predictions if no odometry measures the motion: what fails is that the robot moves evenly.

        The poses that it reaches by accelerating for some `seconds` are searched around the first one. The second one
        is that of any velocity for an `interval`, seconds.
        """
        sigmas = self._velocity.deviations(seconds) + PREDICTION_SIGMAS
        information = information_of(PREDICTION_SIGMAS + MAX_VELOCITIES * interval)
        return replace(even, search_sigmas=sigmas[1:]), replace(uneven, information=information)

    def _by_odometry(
        self, reference: PoseFix, odometry: Odometry, inertia: Prediction | None, cost: float = 0.0
    ) -> Prediction:
        """Return the prediction if the robot has moved from the reference as odometry says."""
        motion, covariance = self._dead_reckoning.motion_and_covariance(reference.odometry, odometry)
        covariance = covariance + self._prediction_error.covariance
        if reference.covariance.any():
            covariance += covariance_after(reference.covariance, motion)
        return Prediction(se2.compose(reference.pose, motion), inverse(covariance), cost, inertia=inertia)

    def _even_motion(
        self, pose: se2.Pose, seconds: float, cost: float = 0.0, *, velocity: VelocityFilter | None = None
    ) -> Prediction:
        """Return the prediction some seconds after `pose` if the robot moves on as it did, whatever odometry says."""
        velocity = velocity or self._velocity
        sigmas = velocity.deviations(seconds) + PREDICTION_SIGMAS
        steady = min(seconds, STEADY_SECONDS) if self.measured else seconds
        return Prediction(se2.compose(pose, velocity.motion(steady)), information_of(sigmas), cost)

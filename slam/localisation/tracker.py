"""Track the pose from scan to scan, including while odometry fails.

Each scan is matched near the pose that odometry predicts from a reference, the last keyframe. Odometry may slip, stand
still for a second and then catch up, jump, or count backwards, so the scan is also matched near the pose of a robot
that moves on evenly, at the velocity of the scans before. If it fits best there, its pose is tentative, and the next
scan decides if odometry continues from there, has caught up, or keeps failing: these are equally probable. If a scan
fits nowhere, the pose follows odometry. After several scans in a row without a certain pose the robot counts as lost.

Without odometry each motion is predicted to be even. Most are, so the prediction is narrow; but a robot that starts or
stops to turn is off by many of its standard deviations, and a scan fits well at many wrong headings. So all poses that
the robot can reach by accelerating are searched at every scan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..geometry.small_matrices import inverse
from ..matching.line_matcher import ScanFeatures
from ..matching.point_matcher import KERNEL, MIN_KNOWN_POINTS, PointMatch, Prediction
from ..odometry.error_model import OdometryModel
from ..odometry.velocity import ACCELERATIONS, MAX_VELOCITIES, ScanClock, VelocityFilter
from .match_target import MIN_WALL_LENGTH, MatchTarget, ScanMatch
from .moving_objects import match_without_moving
from .prediction_error import PREDICTION_SIGMAS, PredictionError
from .tracking import CONDITIONING, PoseFix, TrackerState, TrackingResult, TrackingStatus
from .view_change import View, ViewComparison

# Cost, minus the logarithm of the probability, of odometry failing from one scan to the next.
# Origin: chosen, once in twenty scans that fit badly; not measured.
SLIP_COST = 3.0
# Standard deviations of an even motion beyond which no robot moves, whatever odometry says.
# Origin: chi-square, 3 dof, 99.7 %.
MAX_SLIP = 3.7
# Seconds for which an even motion is predicted while odometry fails. After that time the robot may have any velocity.
# Without odometry there is no such limit: nothing else is known of the motion. Origin: definition, the time in which
# ACCELERATIONS lead to MAX_VELOCITIES.
STEADY_SECONDS = float((MAX_VELOCITIES / ACCELERATIONS).min())
# Points that a scan without walls needs; few points fit nearly everywhere. Origin: chosen; not measured.
MIN_POINTS = 30
# Drop in score from one scan to the next above which the view is compared with the previous one: if that differs as
# well, the robot was kidnapped. Origin: chosen; no measurement recorded.
SUSPICIOUS_DROP = 0.5
# Scans in a row that may fit nowhere, or be tentative, before tracking is lost, or before tentative poses that agree
# with each other are accepted. Origin: measured, on recordings of fifteen drives indoors at most three in a row are
# tentative before the next one decides.
MAX_UNTRACKED_SCANS = 4

# Predictions from a tentative pose. Origin: definition, by odometry and by an even motion.
FROM_TENTATIVE = 2


class Tracker:
    """Pose tracking from the last fix on."""

    def __init__(self, model: OdometryModel) -> None:
        self._model = model
        self._fix: PoseFix | None = None
        self._reference: PoseFix | None = None  # from which odometry predicts
        self._tentative: PoseFix | None = None  # of the last scan, if it was TENTATIVE
        self._before_slip: PoseFix | None = None  # reference before the last slip
        self._since_slip = 0.0  # seconds
        self._since_fix: float | None = None  # seconds; None if no slip is possible
        self._clock, self._velocity = ScanClock(), VelocityFilter()
        self._prediction_error = PredictionError()
        self._untracked_in_a_row = 0
        self._last_score = 0.0  # of the last tracked scan
        self._views = ViewComparison()

    def move_to(self, pose: se2.Pose, odometry: se2.Pose) -> None:
        """Set the fix: the base is at `pose` in the map when odometry is at `odometry`."""
        self._fix = self._reference = PoseFix(pose, odometry)
        self._since_fix = None  # no slip is possible before the next fix
        self._untracked_in_a_row, self._tentative, self._before_slip = 0, None, None

    def start_again(self, pose: se2.Pose, odometry: se2.Pose) -> None:
        """Set the fix in a part of the map that shows nothing yet."""
        self.move_to(pose, odometry)
        self._last_score = 0.0

    def replace_model(self, model: OdometryModel) -> None:
        """Use another error model of odometry from now on."""
        self._model = model

    @property
    def matched_pose(self) -> se2.Pose | None:
        """Pose of the base in the map at the last scan, tracked or tentative; None if that was not matched."""
        if self._tentative is not None:
            return self._tentative.pose
        return None if self._fix is None or self._untracked_in_a_row else self._fix.pose

    @property
    def fix(self) -> PoseFix | None:
        """Last fix; None before the first scan."""
        return self._fix

    @property
    def state(self) -> TrackerState | None:
        """State to be saved; None before the first scan."""
        if self._fix is None or self._reference is None:
            return None
        return TrackerState(
            self._fix, self._reference, self._since_fix, self._clock.last, self._clock.intervals,
            self._velocity.velocity, self._velocity.variances,
            self._prediction_error.variances, self._prediction_error.scans, self._last_score,
        )  # fmt: skip

    def restore(self, state: TrackerState) -> None:
        """Continue from a saved state."""
        self._fix, self._reference = state.fix, state.reference
        self._since_fix, self._clock = state.since_fix, ScanClock(state.scan_stamp, state.intervals)
        self._velocity = VelocityFilter(state.velocity, state.velocity_variances)
        self._prediction_error = PredictionError(state.prediction_variances, state.prediction_scans)
        self._last_score = state.last_score

    def correct(self, pose: se2.Pose) -> None:
        """Replace the pose of the last fix, and predict from it from now on."""
        assert self._fix is not None
        self._fix = self._reference = PoseFix(pose, self._fix.odometry)

    def predict(self, odometry: se2.Pose) -> se2.Pose:
        """Return the base's pose in the map, by odometry alone since the last fix."""
        return np.zeros(3) if self._fix is None else self._extrapolate(self._fix, odometry)

    @property
    def lost(self) -> bool:
        """True if too many scans in a row fitted nowhere, or none of them decided a tentative pose."""
        return self._untracked_in_a_row >= MAX_UNTRACKED_SCANS

    @property
    def view_changed(self) -> bool:
        """True if the view has changed abruptly within the last metres."""
        return self._views.changed

    def track(self, stamp: float, odometry: se2.Pose, scan: ScanFeatures, target: MatchTarget) -> TrackingResult:
        """Estimate the base's pose at a scan taken when odometry was at `odometry`.

        The robot counts as carried if a scan fits worse than the one before and shows another view, or if it fits
        poorly and against odometry and the view has changed recently: it fits here by chance then.
        """
        predictions = self._predict(stamp, odometry)
        match = target.match(scan, predictions, exhaustive=not self._model.measured)
        if self._model.measured:
            match = match_without_moving(match, predictions, scan, target) or match
        alone = self._match_to_last_metres(match, predictions, scan, target)
        match = alone or match
        status, slipped = self._judge(match, predictions, scan, target)
        tracked = status is TrackingStatus.TRACKED
        untracked = status in (TrackingStatus.FAILED, TrackingStatus.TENTATIVE)
        suspicious = untracked or (tracked and match.score < self._last_score - SUSPICIOUS_DROP)
        differs = self._views.add(View(odometry, scan.points.all), self._model, suspicious=suspicious)
        abrupt = tracked and (differs or (slipped and match.poor and self.view_changed))
        if abrupt:
            status, slipped = TrackingStatus.FAILED, False
        follows = self._tentative is not None and match.points.prediction in predictions[-FROM_TENTATIVE:]
        result = self._result(match, status, slipped=slipped, abrupt=abrupt)
        result = replace(result, follows=follows, contradicts_old_map=alone is not None)
        if status is TrackingStatus.TRACKED and self._model.measured:
            predicted, of_match = predictions[0], inverse(match.points.information + CONDITIONING)
            difference = se2.between(predicted.pose, match.points.pose)
            self._prediction_error.add(difference, inverse(predicted.information).diagonal(), of_match.diagonal())
        self._update_fix(result, match.score, odometry)
        return result

    def _match_to_last_metres(
        self, match: ScanMatch, predictions: Sequence[Prediction], scan: ScanFeatures, target: MatchTarget
    ) -> ScanMatch | None:
        """Return the match to the last metres alone, if odometry and these agree, and `match` contradicts them.

        Then odometry has not failed: the robot has come back to a place that was mapped at another pose, and a loop has
        to be closed. If odometry were said to have slipped, the map would tear here.
        """
        usual = predictions[0]
        if target.recent is None or not self._model.measured or not _contradicts(match, usual):
            return None
        last_metres = replace(target, field=target.recent())
        alone = last_metres.match(scan, predictions)
        expected = Prediction(alone.points.pose, _information_of(PREDICTION_SIGMAS))
        elsewhere = expected.squared_distance(match.points.pose) > KERNEL**2
        if _contradicts(alone, usual) or not elsewhere or alone.known < MIN_KNOWN_POINTS or alone.poor:
            return None
        return alone if last_metres.contradict(scan, match.points.pose) else None

    def _predict(self, stamp: float, odometry: se2.Pose) -> list[Prediction]:
        """Return the predictions of the pose: the usual one first, and that after a slip second, if one is possible.

        Then those of odometry that has caught up after the last slip, and of the motion from a tentative pose.
        """
        if self._fix is None or self._reference is None:
            self.move_to(np.zeros(3), odometry)
        interval = self._clock.interval(stamp)
        self._since_fix = None if self._since_fix is None else self._since_fix + interval
        usual, slip = self._usual_and_slip(odometry, interval)
        predictions = [usual] if self._since_fix is None else [usual, slip]
        self._since_slip += interval
        if self._before_slip is not None and self._since_slip < STEADY_SECONDS:
            predictions.append(self._by_odometry(self._before_slip, odometry, slip))
        if self._tentative is not None:
            even = self._even_motion(self._tentative.pose, interval)
            predictions += [self._by_odometry(self._tentative, odometry, even), even]  # FROM_TENTATIVE
        return predictions

    def _judge(
        self, match: ScanMatch, predictions: Sequence[Prediction], scan: ScanFeatures, target: MatchTarget
    ) -> tuple[TrackingStatus, bool]:
        """Return the status of a scan, and True if odometry has slipped; the predictions are those of `_predict`."""
        usual, slip = predictions[0], predictions[1] if len(predictions) > 1 else None
        chosen, pose = match.points.prediction, match.points.pose
        contradicts = usual.squared_distance(pose) > KERNEL**2
        # Poses were searched around both motions, and the best one agrees with odometry: that has not failed.
        resolved = (self._tentative is not None or chosen is not slip) and not contradicts
        confirmed = not resolved and chosen is not usual and chosen is not slip
        slipped = (
            not resolved
            and chosen is slip
            and not any(other.prediction is usual and _same_place(match, other) for other in match.others)
        )
        if _too_few_features(scan) and len(target.landmarks.walls):
            return TrackingStatus.NO_FEATURES, False
        if not match.plausible or (slipped and chosen.squared_distance(pose) > MAX_SLIP**2):
            return TrackingStatus.FAILED, False
        # The poses of the last scans agree with each other, and nothing suggests that the robot was carried.
        agree_for_long = self._untracked_in_a_row + 1 >= MAX_UNTRACKED_SCANS and not self.view_changed
        if slipped or (confirmed and (match.poor or _ambiguous(match)) and not agree_for_long):
            return TrackingStatus.TENTATIVE, False
        return TrackingStatus.TRACKED, confirmed or contradicts

    def _update_fix(self, result: TrackingResult, score: float, odometry: se2.Pose) -> None:
        """Remember the pose of a scan as the fix or as tentative, as its result says."""
        self._tentative = None
        if result.status is TrackingStatus.NO_FEATURES:
            return
        fix = PoseFix(result.pose, odometry)
        self._untracked_in_a_row += 1
        if result.status is TrackingStatus.TENTATIVE:
            self._tentative = fix
        if result.status is not TrackingStatus.TRACKED:
            return
        assert self._fix is not None
        self._last_score = score
        if self._since_fix:
            self._velocity.correct(se2.between(self._fix.pose, fix.pose), result.registered_covariance, self._since_fix)
        self._fix, self._since_fix, self._untracked_in_a_row = fix, 0.0, 0
        if result.slipped and self._model.measured:
            self._before_slip, self._since_slip = self._reference, 0.0
        if result.slipped or not self._model.measured:  # odometry continues from here
            self._reference = fix

    def _usual_and_slip(self, odometry: se2.Pose, interval: float) -> tuple[Prediction, Prediction]:
        """Return the prediction by odometry and that after its failure, `interval` seconds after the last scan."""
        assert self._fix is not None
        assert self._reference is not None
        slip = self._even_motion(self._fix.pose, self._since_fix or 0.0, SLIP_COST)
        if not self._model.measured:  # the usual motion is an even one: what fails is that the robot moves evenly
            slip = replace(slip, information=_information_of(PREDICTION_SIGMAS + MAX_VELOCITIES * interval))
            sigmas = self._velocity.deviations(self._since_fix or 0.0) + PREDICTION_SIGMAS
            return replace(self._by_odometry(self._reference, odometry, None), search_sigmas=sigmas[1:]), slip
        inertia = slip if self._since_fix is not None else None
        return self._by_odometry(self._reference, odometry, inertia), slip

    def _by_odometry(self, reference: PoseFix, odometry: se2.Pose, inertia: Prediction | None) -> Prediction:
        """Return the prediction if the robot has moved from the reference as odometry says."""
        motion = reference.odometry_motion(odometry)
        pose = se2.compose(reference.pose, self._model.correct(motion))
        information = inverse(self._model.covariance(motion) + self._prediction_error.covariance)
        return Prediction(pose, information, inertia=inertia)

    def _even_motion(self, pose: se2.Pose, seconds: float, cost: float = 0.0) -> Prediction:
        """Return the prediction some seconds after `pose` if the robot moves on as it did, whatever odometry says."""
        sigmas = self._velocity.deviations(seconds) + PREDICTION_SIGMAS
        steady = min(seconds, STEADY_SECONDS) if self._model.measured else seconds
        return Prediction(se2.compose(pose, self._velocity.motion(steady)), _information_of(sigmas), cost)

    def _result(self, match: ScanMatch, status: TrackingStatus, *, slipped: bool, abrupt: bool) -> TrackingResult:
        prior = match.points.prediction.information
        covariance = np.asarray(inverse(match.points.information + prior))
        registered = np.asarray(inverse(match.registration.total_information + prior))
        return TrackingResult(
            match.points.pose,
            covariance,
            match.registration,
            registered,
            match.points.prediction,
            status,
            match.familiarity,
            match.known,
            match.poor,
            slipped,
            abrupt,
        )

    def _extrapolate(self, fix: PoseFix, odometry: se2.Pose) -> se2.Pose:
        return se2.compose(fix.pose, self._model.correct(fix.odometry_motion(odometry)))


def _information_of(sigmas: Floats) -> Floats:
    """Return the information (3, 3) of a pose whose components have the standard deviations `sigmas` (3,)."""
    information = np.zeros((3, 3))
    information.flat[::4] = sigmas**-2.0
    return information


def _contradicts(match: ScanMatch, usual: Prediction) -> bool:
    """Return True if a match contradicts odometry, whose prediction is the `usual` one."""
    return match.points.prediction is not usual or usual.squared_distance(match.points.pose) > KERNEL**2


def _too_few_features(scan: ScanFeatures) -> bool:
    return scan.segments.total_length < MIN_WALL_LENGTH and len(scan.points.all) < MIN_POINTS


def _same_place(match: ScanMatch, other: PointMatch) -> bool:
    """Return True if a match near another prediction has led to the same place: both predictions hold then."""
    return bool(np.all(np.abs(se2.between(other.pose, match.points.pose)) < PREDICTION_SIGMAS))


def _ambiguous(match: ScanMatch) -> bool:
    """Return True if the scan fits about as well at another place."""
    return any(other.cost < match.points.cost + SLIP_COST and not _same_place(match, other) for other in match.others)

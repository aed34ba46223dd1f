"""Track the pose from scan to scan, also where odometry slips or is failing.

Each scan is matched near the pose that odometry predicts from a reference, the last keyframe. Odometry may slip, stand
still for a second and then catch up, jump, or count backwards, so the scan is also matched near the pose of a robot
that moves on evenly, at the velocity of the scans before. Odometry holds unless the points of the scan contradict it.
If they do, and the scan fits best at the even motion, its pose is tentative, and the next scan decides if odometry
continues from there, has caught up, or keeps slipping: these are equally probable. If a scan fits nowhere, the pose
follows odometry. After several scans in a row without a certain pose the robot counts as lost.

Without odometry, and while it is failing, each motion is predicted to be even. Most are, so the prediction is
narrow; but a robot that starts or stops to turn is off by many of its standard deviations, and a scan fits well at many
wrong headings. So all poses that the robot can reach by accelerating are searched at every scan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from drivers import se2
from drivers.messages import Odometry
from drivers.small_matrices import inverse

from ..geometry.segments import Floats
from ..geometry.surroundings import MIN_WALL_LENGTH
from ..matching.point_matcher import MIN_KNOWN_POINTS, PointMatch, Prediction, information_of
from ..matching.scan_features import ScanFeatures
from ..odometry.dead_reckoning import DeadReckoning
from ..odometry.velocity import VelocityFilter
from .followed_motion import Compare
from .match_target import MatchTarget, ScanMatch
from .pose_predictor import PosePredictor
from .prediction_error import PREDICTION_SIGMAS
from .predictions import Predictions, TentativePose
from .slip_evidence import SlipEvidence
from .small_objects import SmallObjects, lasting_points
from .tracking import PoseFix, TrackerState, TrackingResult, TrackingStatus
from .view_change import MIN_POINTS, View, ViewComparison

# Drop in score from one scan to the next above which the view is compared with the previous one: if that differs as
# well, the robot was kidnapped. Origin: chosen; no measurement recorded.
SUSPICIOUS_DROP = 0.5
# Scans in a row that may fit nowhere, or be tentative, before tracking is lost, or before tentative poses that agree
# with each other are accepted. Origin: measured, on recordings of fifteen drives indoors at most three in a row are
# tentative before the next one decides.
MAX_UNTRACKED_SCANS = 4


class Tracker:
    """Pose tracking from the last fix on."""

    def __init__(self, dead_reckoning: DeadReckoning) -> None:
        self._dead_reckoning, self._predictor = dead_reckoning, PosePredictor(dead_reckoning)
        self._untracked_in_a_row = 0
        self._carried = False  # since the fix, although the wheels stood
        self._last_score = 0.0  # of the last tracked scan
        self._views, self._small_objects = ViewComparison(), SmallObjects()

    def move_to(self, pose: se2.Pose, odometry: Odometry) -> None:
        """Set the fix: the base is at `pose` in the map at a reading of odometry."""
        self._predictor.move_to(pose, odometry)
        self._untracked_in_a_row, self._carried = 0, False

    def start_again(self, pose: se2.Pose, odometry: Odometry) -> None:
        """Set the fix in a part of the map that shows nothing yet."""
        self._predictor.start_again(pose, odometry)
        self._untracked_in_a_row, self._carried, self._last_score = 0, False, 0.0

    @property
    def matched_pose(self) -> se2.Pose | None:
        """Pose of the base in the map at the last scan, tracked or tentative; None if that was not matched."""
        if self._predictor.tentative is not None:
            return self._predictor.tentative.pose
        return None if self.fix is None or self._untracked_in_a_row else self.fix.pose

    @property
    def fix(self) -> PoseFix | None:
        """Last fix; None before the first scan."""
        return self._predictor.fix

    @property
    def state(self) -> TrackerState | None:
        """State to be saved; None before the first scan."""
        return self._predictor.state(self._small_objects, self._last_score)

    def restore(self, state: TrackerState) -> None:
        """Continue from a saved state."""
        self._predictor.restore(state)
        self._small_objects, self._last_score = replace(state.small_objects), state.last_score

    def correct(self, pose: se2.Pose, covariance: Floats | None = None) -> None:
        """Replace the pose of the last fix, and predict from it from now on; for the covariance see `PoseFix`."""
        self._predictor.correct(pose, covariance)

    def predict(self, odometry: Odometry) -> se2.Pose:
        """Return the base's pose in the map, by odometry alone since the last fix."""
        return self._predictor.extrapolate(odometry)

    @property
    def lost(self) -> bool:
        """True if too many scans in a row fitted nowhere, or none of them decided a tentative pose."""
        return self._untracked_in_a_row >= MAX_UNTRACKED_SCANS

    @property
    def odometry_failing(self) -> bool:
        """True if there is odometry, but it is failing, so that the motion is predicted without it."""
        return self._predictor.odometry_failing

    def stop_odometry(self) -> None:
        """Take odometry as failing, as its readings have stopped, until it agrees with the scans again."""
        self._predictor.stop_odometry()

    @property
    def predicted_velocity(self) -> VelocityFilter | None:
        """Velocity at the last fix, by which the motion is predicted while odometry is failing; None if it is not."""
        return self._predictor.velocity if self.odometry_failing else None

    @property
    def may_have_been_carried(self) -> bool:
        """True if something suggests that the robot was carried while its wheels stood: the view, or a gap.

        A scan fits where no motion leads, the view has changed abruptly within the last metres, or in a gap before the
        scans that are not tracked, so many are missing that the robot would be lost if these had fitted nowhere.
        """
        if self._carried or self._views.changed:
            return True
        return self._is_after_gap(self._untracked_in_a_row) and self._predictor.stood_in_gap

    def _is_after_gap(self, taken: int) -> bool:
        """Return True if the last `taken` scans follow a gap in which the robot may have moved to any place.

        So many scans are missing that it would be lost if these had fitted nowhere.
        """
        return self._predictor.is_after_gap(taken, MAX_UNTRACKED_SCANS)

    def track(self, odometry: Odometry, scan: ScanFeatures, target: MatchTarget) -> TrackingResult:
        """Estimate the base's pose at a scan, given the reading of odometry at its stamp.

        The robot counts as carried if a scan fits worse than the one before and shows another view, or if it fits
        poorly and against odometry and the view has changed recently: it fits here by chance then. It was carried, too,
        if its wheels stood and a scan fits well where no motion leads, or shows another view and fits nowhere within
        reach. More poses are within reach of the next scans, although the robot stands by then: one of them may fit by
        chance, so only the one that odometry predicts counts.
        """
        predictions = self._predictor.predict(odometry)
        points = self._small_objects.weighted_points(scan)
        match = self._match(scan, points, predictions, target)
        alone = self._match_to_last_metres(match, predictions.all, scan, points, target)
        evidence = SlipEvidence(alone or match, predictions)
        match = evidence.match
        status, slipped = self._judge(evidence, scan, target)
        if self._carried and status is not TrackingStatus.NO_FEATURES and not evidence.odometry_holds:
            status, slipped = TrackingStatus.FAILED, False
        tracked = status is TrackingStatus.TRACKED
        untracked = status in (TrackingStatus.FAILED, TrackingStatus.TENTATIVE)
        suspicious = untracked or (tracked and match.score < self._last_score - SUSPICIOUS_DROP)
        failed = status is TrackingStatus.FAILED
        differs = self._views.add(
            View(odometry, scan.points.xy),
            self._dead_reckoning,
            suspicious=suspicious and self.measured,
            fits_nowhere=failed,
        )
        fits_beyond_reach = (
            failed and evidence.needs_impossible_motion and not match.poor and self._predictor.stood(odometry)
        )
        self._carried = self._carried or (failed and differs) or fits_beyond_reach
        fits_by_chance = tracked and (differs or (slipped and match.poor and self._views.changed))
        if fits_by_chance:
            status, slipped = TrackingStatus.FAILED, False
        if self.odometry_failing:
            slipped = status is TrackingStatus.TRACKED
        result = _result(
            match,
            status,
            slipped=slipped,
            fits_by_chance=fits_by_chance,
            from_tentative=match.points.prediction in predictions.from_tentative,
            contradicts_old_map=alone is not None,
        )
        if status is TrackingStatus.TRACKED:
            self._small_objects.add(scan, result.pose, target.field, self._predictor.interval)
        is_certain = partial(target.excludes, points=points, pose=match.points.pose)

        def compare(prediction: Prediction, pose: se2.Pose) -> tuple[PointMatch | None, float]:
            return target.compare(lasting_points(scan), prediction, pose)

        self._update(result, evidence, odometry, is_certain, compare)
        return result

    def _match(self, scan: ScanFeatures, points: Floats, predictions: Predictions, target: MatchTarget) -> ScanMatch:
        """Match a scan, whose weighted points are (p, 6), near all predictions."""
        return target.match(
            scan,
            predictions.all,
            points,
            exhaustive=not self.measured,
            earlier_evidence=predictions.evidence if self.measured else None,
            after_gap=self._is_after_gap(self._untracked_in_a_row + 1),
        )

    def _update(
        self,
        result: TrackingResult,
        evidence: SlipEvidence,
        odometry: Odometry,
        is_certain: Callable[[Prediction], bool],
        compare: Compare,
    ) -> None:
        """Keep what the predictions of the next scans need of a match; for the last two see `PosePredictor.update`."""
        if result.status is TrackingStatus.TRACKED:
            self._last_score, self._untracked_in_a_row, self._carried = evidence.match.score, 0, False
            if self.measured:
                self._predictor.learn(evidence.predictions.usual, evidence.match.points)
        elif result.status is not TrackingStatus.NO_FEATURES:
            self._untracked_in_a_row += 1
        tentative: TentativePose | None = None
        if result.status is TrackingStatus.TENTATIVE:
            alternative = evidence.alternative if self.measured else None
            followed = evidence.predictions.followed if evidence.fits_slip else None
            tentative = TentativePose(PoseFix(result.pose, odometry), alternative, evidence.match.evidence, followed)
        self._predictor.update(result, odometry, tentative, is_certain, compare)

    @property
    def measured(self) -> bool:
        """True if odometry measures the motion: there is odometry, and it is not failing."""
        return self._predictor.measured

    def _match_to_last_metres(
        self,
        match: ScanMatch,
        predictions: Sequence[Prediction],
        scan: ScanFeatures,
        points: Floats,
        target: MatchTarget,
    ) -> ScanMatch | None:
        """Return the match to the last metres alone, if odometry and these agree, and `match` contradicts them.

        Then odometry has not failed: the robot has come back to a place that was mapped at another pose, and a loop has
        to be closed. If odometry were said to have slipped, the map would tear here.
        """
        usual = predictions[0]
        if target.recent is None or not self.measured or not match.contradicts(usual):
            return None
        last_metres = replace(target, field=target.recent())
        alone = last_metres.match(scan, predictions, points)
        expected = Prediction(alone.points.pose, information_of(PREDICTION_SIGMAS))
        elsewhere = expected.excludes(match.points.pose)
        if alone.contradicts(usual) or not elsewhere or alone.known < MIN_KNOWN_POINTS or alone.poor:
            return None
        return alone if last_metres.contradicts(points, match.points.pose) else None

    def _judge(self, evidence: SlipEvidence, scan: ScanFeatures, target: MatchTarget) -> tuple[TrackingStatus, bool]:
        """Return the status of a scan, and True if it shows that odometry has slipped since its reference."""
        match, confirms_slip, seems_slipped = evidence.match, evidence.confirms_slip, evidence.seems_slipped
        if _too_few_features(scan) and len(target.landmarks.walls):
            return TrackingStatus.NO_FEATURES, False
        scans = self._untracked_in_a_row + 1
        after_gap = self._is_after_gap(scans)
        # After a gap neither an even motion nor a tentative pose predicts anything: any place may look alike.
        may_be_anywhere = after_gap and self.measured and (seems_slipped or confirms_slip)
        if not match.plausible or evidence.needs_impossible_motion or may_be_anywhere:
            return TrackingStatus.FAILED, False
        # The poses of the last scans agree with each other, and nothing suggests that the robot was carried.
        agree_for_long = scans >= MAX_UNTRACKED_SCANS and not self._views.changed and not after_gap
        ambiguous = confirms_slip and evidence.is_ambiguous and not agree_for_long
        # A poor fit shows no slip. Nor does it place a robot after a gap in which nothing has measured the motion, or a
        # scan of what was hardly seen before: odometry is missing or failing, or the robot may have been carried.
        places_nothing = match.poor or match.known < MIN_KNOWN_POINTS
        unplaced = places_nothing and after_gap and not self._predictor.measured_in_gap
        if seems_slipped or ambiguous or unplaced or (match.poor and confirms_slip):
            return TrackingStatus.TENTATIVE, False
        return TrackingStatus.TRACKED, confirms_slip or evidence.contradicts_odometry


def _result(
    match: ScanMatch,
    status: TrackingStatus,
    *,
    slipped: bool,
    fits_by_chance: bool,
    from_tentative: bool,
    contradicts_old_map: bool,
) -> TrackingResult:
    """Return the result of tracking with a match; for the other arguments see `TrackingResult`."""
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
        match.explained,
        match.known,
        match.poor,
        slipped,
        fits_by_chance,
        from_tentative,
        contradicts_old_map,
    )


def _too_few_features(scan: ScanFeatures) -> bool:
    return scan.segments.total_length < MIN_WALL_LENGTH and len(scan.points.xy) < MIN_POINTS

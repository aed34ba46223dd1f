"""Track the pose from scan to scan, including while odometry fails.

Odometry may slip, stand still for a second and then catch up, or jump. If a scan fits neither the walls nor the points
of the last keyframes at the pose that odometry predicts, its pose is searched for with the raw points. Scans that fit
nowhere are left out. After several of them in a row the place counts as new if the map does not extend there, and the
robot as lost if it does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..matching.likelihood_field import search_pose
from ..matching.line_matcher import NEAR_STARTS, Registration, ScanFeatures
from ..odometry.error_model import OdometryModel
from ..odometry.history import wheel_travel
from .match_target import MatchTarget, ScanMatch
from .view_change import View

# Metres, metres, radians: added to the odometry model's own uncertainty in the prediction of a scan's pose, for wheel
# slip and clock differences. Origin: chosen; no measurement recorded.
PREDICTION_SIGMAS = np.array([0.05, 0.05, np.radians(4.0)])
# By which the likelihood score at a searched pose must exceed that at the predicted pose.
# Origin: chosen; no measurement recorded.
MIN_SEARCH_GAIN = 0.1
# Likelihood score that a searched pose must reach. Origin: chosen; no measurement recorded.
MIN_SEARCH_SCORE = 0.5
# Points that a scan needs for a search; few points fit nearly everywhere. Origin: chosen; not measured.
MIN_SEARCH_POINTS = 30
# Metres of wheel travel between two scans above which odometry may be catching up after standing still.
# Origin: chosen; no measurement recorded.
LARGE_STEP = 0.8
# Score by which a scan must fit better at the previous pose than at the predicted one in that case.
# Origin: chosen; no measurement recorded.
STOPPED_MARGIN = 0.3
# Metres and radians by which odometry's step may differ from the previous step without an even motion being tried as
# well. Origin: chosen; no measurement recorded.
UNEVEN_STEP = 0.1
UNEVEN_TURN = np.radians(5.0)  # Origin: as UNEVEN_STEP.
# Score by which a scan must fit better after an even motion than after odometry's motion.
# Origin: chosen; no measurement recorded.
EVEN_MOTION_MARGIN = 0.15
# Drop in score from one scan to the next that, together with a changed view, suggests that the robot was kidnapped.
# Origin: chosen; no measurement recorded.
ABRUPT_DROP = 1.0
# Drop in score above which the view is compared with the previous one. Origin: chosen; no measurement recorded.
SUSPICIOUS_DROP = 0.5
# Metres of wheel travel for which a changed view counts as recent: look-alike places differ some way on.
# Origin: chosen; no measurement recorded.
VIEW_CHANGE_MEMORY = 10.0
# Scans in a row that may fit nowhere before tracking is lost. Origin: chosen, less than a second; not measured.
MAX_FAILED_SCANS = 4
# Mapped ratio below which the place counts as new instead of the robot as lost.
# Origin: chosen; no measurement recorded.
MAX_MAPPED_RATIO_OF_NEW_PLACE = 0.3
# Metres of wall below which a scan with few points cannot be registered. Origin: chosen; not measured.
MIN_WALL_LENGTH = 0.5


class TrackingStatus(Enum):
    """Outcome of tracking one scan."""

    TRACKED = "tracked"  # registered near the predicted pose
    TENTATIVE = "tentative"  # found by the wide search; enters the trajectory once the next scan confirms it
    FAILED = "failed"  # fits nowhere near
    NO_FEATURES = "no features"  # too little wall and too few points


@dataclass(frozen=True, slots=True, eq=False)
class TrackingResult:
    """Pose of a scan.

    covariance        (3, 3) of the pose in the map as it stands, in the base's frame
    confirms_search   True if this scan confirms the tentative pose of the scan before
    abrupt            True if the scan fits far worse than the one before and the view changed recently: the robot may
                      have been kidnapped
    """

    registration: Registration
    status: TrackingStatus
    covariance: Floats
    confirms_search: bool
    abrupt: bool

    @property
    def pose(self) -> se2.Pose:
        """Pose of the base in the map."""
        return self.registration.pose


@dataclass(frozen=True, slots=True, eq=False)
class PoseFix:
    """Pose of the base in the map, and the odometry pose at the same time."""

    pose: se2.Pose
    odometry: se2.Pose

    def odometry_motion(self, odometry: se2.Pose) -> se2.Pose:
        """Return the motion [x, y, heading] since then according to odometry."""
        return se2.between(self.odometry, odometry)


class Tracker:
    """Pose tracking from the last fix on."""

    def __init__(self, model: OdometryModel) -> None:
        self._model = model
        self._fix: PoseFix | None = None
        self._step = np.zeros(3)  # motion between the last two tracked scans
        self._failed_in_a_row = 0
        self._last_score = 0.0  # of the last tracked scan
        # The fix before a wide search. Odometry may catch up in one step after standing still, or the search was wrong.
        self._fix_before_search: PoseFix | None = None
        self._view: View | None = None  # last view with enough points for a comparison
        self._odometry: se2.Pose | None = None  # at the last scan
        self._travel_since_view_change = np.inf  # metres

    def move_to(self, pose: se2.Pose, odometry: se2.Pose) -> None:
        """Set the fix: the base is at `pose` in the map when odometry is at `odometry`."""
        self._fix, self._failed_in_a_row, self._fix_before_search = PoseFix(pose, odometry), 0, None

    @property
    def fix(self) -> PoseFix | None:
        """Last fix; None before the first scan."""
        return self._fix

    @property
    def step(self) -> se2.Pose:
        """Motion between the last two tracked scans."""
        return self._step

    @property
    def last_score(self) -> float:
        """Match score of the last tracked scan."""
        return self._last_score

    def restore(self, fix: PoseFix, step: se2.Pose, last_score: float) -> None:
        """Continue from the saved properties of another tracker."""
        self._fix, self._step, self._last_score = fix, step, last_score

    def correct(self, pose: se2.Pose) -> None:
        """Replace the pose of the last fix after the map has changed."""
        assert self._fix is not None
        self._fix = PoseFix(pose, self._fix.odometry)

    def predict(self, odometry: se2.Pose) -> se2.Pose:
        """Return the base's pose in the map, by odometry alone since the last fix."""
        return np.zeros(3) if self._fix is None else self._extrapolate(self._fix, odometry)

    @property
    def lost(self) -> bool:
        """True if too many scans in a row fitted nowhere."""
        return self._failed_in_a_row >= MAX_FAILED_SCANS

    @property
    def view_changed(self) -> bool:
        """True if the view has changed abruptly within the last metres."""
        return bool(self._travel_since_view_change < VIEW_CHANGE_MEMORY)

    def track(self, odometry: se2.Pose, scan: ScanFeatures, target: MatchTarget) -> TrackingResult:
        """Estimate the base's pose at a scan taken when odometry was at `odometry`."""
        score_before, view = self._last_score, View(odometry, scan.points.all)
        result = self._track(odometry, scan, target)
        if self._odometry is not None:
            self._travel_since_view_change += float(wheel_travel(se2.between(self._odometry, odometry)))
        unregistered = result.status in (TrackingStatus.FAILED, TrackingStatus.TENTATIVE)
        if (unregistered or self._last_score < score_before - SUSPICIOUS_DROP) and self._view_differs(view):
            self._travel_since_view_change = 0.0
        self._odometry = odometry
        if view.comparable:
            self._view = view
        return replace(result, abrupt=result.abrupt and self.view_changed)

    def _view_differs(self, view: View) -> bool:
        """Return True if a view shows another place than the last one, or if there is no last one."""
        if self._view is None:
            return True
        motion = self._model.correct(se2.between(self._view.odometry, view.odometry))
        return self._view.differs_from(view, motion)

    def _track(self, odometry: se2.Pose, scan: ScanFeatures, target: MatchTarget) -> TrackingResult:
        if self._fix is None:
            self.move_to(np.zeros(3), odometry)
        assert self._fix is not None
        prior = self._prior(odometry)
        after_search = self._fix_before_search is not None
        predictions, margins = self._predictions(odometry)
        matches = [target.match(scan, prediction, prior) for prediction in predictions]
        best = int(np.argmax([match.score - margin for match, margin in zip(matches, margins, strict=True)]))
        match = matches[best]
        confirms_search = after_search and best < len(predictions) - 1
        map_is_empty = not len(target.landmarks.walls)
        if _too_few_features(scan) and not map_is_empty:
            return self._result(match, TrackingStatus.NO_FEATURES, prior)
        if match.plausible or map_is_empty:
            self._step = se2.between(self._fix.pose, match.registration.pose)
            self.move_to(match.registration.pose, odometry)
            return self._result(match, TrackingStatus.TRACKED, prior, confirms_search)
        found = self._search(scan, target, predictions[-1], match.likelihood)
        if found is None:
            self._failed_in_a_row += 1
            in_map = target.mapped_ratio(scan, match.registration.pose) >= MAX_MAPPED_RATIO_OF_NEW_PLACE
            if not self.lost or in_map:
                return self._result(match, TrackingStatus.FAILED, prior)
            self.move_to(match.registration.pose, odometry)
            return self._result(match, TrackingStatus.TRACKED, prior)
        match = target.match(scan, found, prior, NEAR_STARTS[:1])
        before = self._fix
        self.move_to(match.registration.pose, odometry)
        self._fix_before_search = before
        status = TrackingStatus.TRACKED if after_search else TrackingStatus.TENTATIVE
        return self._result(match, status, prior, after_search)

    def _result(
        self, match: ScanMatch, status: TrackingStatus, prior: Floats, confirms_search: bool = False
    ) -> TrackingResult:
        covariance = np.asarray(np.linalg.inv(match.registration.total_information + prior))
        abrupt = status is TrackingStatus.TRACKED and match.score < self._last_score - ABRUPT_DROP
        if status in (TrackingStatus.TRACKED, TrackingStatus.TENTATIVE):
            self._last_score = match.score
        return TrackingResult(match.registration, status, covariance, confirms_search, abrupt)

    def _predictions(self, odometry: se2.Pose) -> tuple[list[se2.Pose], list[float]]:
        """Return candidate poses, and for each the margin by which its match score must exceed that of the first.

        1. Odometry since the last fix.
        2. An even motion, if odometry's step is unlike the step before.
        3. The last fix, if odometry may be catching up.
        4. Odometry since the fix before, if the last fix is tentative.
        """
        assert self._fix is not None
        predictions, margins = [self._extrapolate(self._fix, odometry)], [0.0]
        step = self._model.correct(self._fix.odometry_motion(odometry))
        change = se2.between(self._step, step)
        if np.hypot(change[0], change[1]) > UNEVEN_STEP or abs(change[2]) > UNEVEN_TURN:
            predictions.append(se2.compose(self._fix.pose, self._step))
            margins.append(EVEN_MOTION_MARGIN)
        if self._fix_before_search is not None:
            before_search = self._extrapolate(self._fix_before_search, odometry)
            return [*predictions, self._fix.pose, before_search], [*margins, 0.0, 0.0]
        if wheel_travel(step) > LARGE_STEP:
            return [*predictions, self._fix.pose], [*margins, STOPPED_MARGIN]
        return predictions, margins

    def _extrapolate(self, fix: PoseFix, odometry: se2.Pose) -> se2.Pose:
        return se2.compose(fix.pose, self._model.correct(fix.odometry_motion(odometry)))

    def _search(self, scan: ScanFeatures, target: MatchTarget, near: se2.Pose, score: float) -> se2.Pose | None:
        """Return a pose at which the likelihood clearly exceeds `score`, that at the predicted pose; None without."""
        if len(scan.points.all) < MIN_SEARCH_POINTS:
            return None
        pose, found = search_pose(target.field, scan.points.all, near)
        return pose if found >= max(MIN_SEARCH_SCORE, score + MIN_SEARCH_GAIN) else None

    def _prior(self, odometry: se2.Pose) -> Floats:
        """Return the information (3, 3) of the pose predicted with `odometry`, in the base's frame."""
        assert self._fix is not None
        covariance = self._model.covariance(self._fix.odometry_motion(odometry)) + np.diag(PREDICTION_SIGMAS**2)
        return np.asarray(np.linalg.inv(covariance))


def _too_few_features(scan: ScanFeatures) -> bool:
    return 2 * scan.segments.half_length.sum() < MIN_WALL_LENGTH and len(scan.points.all) < MIN_SEARCH_POINTS

"""Track the pose from scan to scan, including while odometry fails.

Each scan is matched near the pose that odometry predicts from a reference, the last keyframe. Odometry may slip, stand
still for a second and then catch up, or jump: a scan that does not fit there is searched for around it. If it fits
nowhere, the pose follows odometry. After several scans in a row without a certain pose the robot counts as lost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..matching.line_matcher import Registration, ScanFeatures
from ..matching.point_matcher import KERNEL, Prediction
from ..odometry.error_model import OdometryModel
from ..odometry.history import wheel_travel
from .match_target import MatchTarget, ScanMatch
from .view_change import View

# Metres, metres, radians: standard deviations of a prediction beside odometry's own, from the error of the reference
# and from clock differences. Origin: chosen; no measurement recorded.
PREDICTION_SIGMAS = np.array([0.02, 0.02, np.radians(1.0)])
PREDICTION_COVARIANCE = np.diag(PREDICTION_SIGMAS**2)  # Origin: definition.
# Cost, minus the logarithm of the probability, of odometry failing from one scan to the next.
# Origin: chosen, once in twenty scans that fit badly; not measured.
SLIP_COST = 3.0
# Standard deviations of a slip's prediction within which the pose must be: no robot becomes twice as fast at once.
# Origin: chosen; not measured.
MAX_SLIP = 2.0
# Scale of the kernel of a slip's prediction, whose bound is physical. Origin: numerical, practically none.
NO_KERNEL = 1e3
# Metres and radians per second that every robot reaches. Origin: chosen, slow robots; not measured.
MIN_SPEEDS = np.array([0.2, 0.3])
# Seconds over which speeds are measured: stamps of single scans may be late by some tenths, or come in bursts.
# Origin: chosen, several times the delays of a busy logging computer; not measured.
SPEED_INTERVAL = 1.0
# Points that a scan without walls needs; few points fit nearly everywhere. Origin: chosen; not measured.
MIN_POINTS = 30
# Drop in score from one scan to the next that, together with a changed view, is due to a kidnapping.
# Origin: chosen; no measurement recorded.
ABRUPT_DROP = 1.0
# Drop in score above which the view is compared with the previous one. Origin: chosen; no measurement recorded.
SUSPICIOUS_DROP = 0.5
# Metres of wheel travel for which a changed view counts as recent: look-alike places differ some way on.
# Origin: chosen; no measurement recorded.
VIEW_CHANGE_MEMORY = 10.0
# Scans in a row that may fit nowhere, or be tentative, before tracking is lost. Origin: measured, on recordings of
# fifteen drives indoors at most three in a row are tentative before the next one decides.
MAX_UNTRACKED_SCANS = 4
# Metres of wall below which a scan with few points cannot be registered. Origin: chosen; not measured.
MIN_WALL_LENGTH = 0.5


class TrackingStatus(Enum):
    """Outcome of tracking one scan."""

    TRACKED = "tracked"  # matched
    TENTATIVE = "tentative"  # matched far from odometry: the next scan that fits well decides
    FAILED = "failed"  # fits nowhere near
    NO_FEATURES = "no features"  # too little wall and too few points


@dataclass(frozen=True, slots=True, eq=False)
class TrackingResult:
    """Pose of a scan.

    covariance  (3, 3) of the pose in the map as it stands, in the base's frame
    slipped     True if odometry's motion since the reference contradicts the pose
    abrupt      True if the scan fits far worse than the one before and the view changed recently: the robot may have
                been kidnapped
    """

    registration: Registration
    status: TrackingStatus
    covariance: Floats
    slipped: bool
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


@dataclass(frozen=True, slots=True, eq=False)
class TrackerState:
    """State of tracking that a session stores.

    fix         last pose fix
    reference   from which odometry predicts
    fix_stamp   seconds, of the last fix; None if no slip is possible before the next one
    speeds      (2,) metres and radians per second that the robot has reached
    speed_start stamp and odometry pose from which the next speed is measured; None if it is not known
    last_score  match score of the last tracked scan
    """

    fix: PoseFix
    reference: PoseFix
    fix_stamp: float | None
    speeds: Floats
    speed_start: tuple[float, se2.Pose] | None
    last_score: float


class Tracker:
    """Pose tracking from the last fix on."""

    def __init__(self, model: OdometryModel) -> None:
        self._model = model
        self._fix: PoseFix | None = None
        self._reference: PoseFix | None = None  # from which odometry predicts
        self._tentative: PoseFix | None = None  # of the last scan, if it was TENTATIVE
        self._usual_cost = 0.0  # by which the usual prediction was worse than the tentative one
        self._fix_stamp = np.inf  # seconds, of the last fix
        self._speeds = MIN_SPEEDS  # metres and radians per second that the robot has reached
        self._speed_start: tuple[float, se2.Pose] | None = None  # stamp and odometry at the start of the interval
        self._untracked_in_a_row = 0
        self._last_score = 0.0  # of the last tracked scan
        self._view: View | None = None  # last view with enough points for a comparison
        self._odometry: se2.Pose | None = None  # at the last scan
        self._travel_since_view_change = np.inf  # metres

    def move_to(self, pose: se2.Pose, odometry: se2.Pose) -> None:
        """Set the fix: the base is at `pose` in the map when odometry is at `odometry`."""
        self._fix = self._reference = PoseFix(pose, odometry)
        self._fix_stamp = np.inf  # no slip is possible before the next fix
        self._untracked_in_a_row, self._tentative, self._usual_cost = 0, None, 0.0

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
        stamp = float(self._fix_stamp) if np.isfinite(self._fix_stamp) else None
        return TrackerState(self._fix, self._reference, stamp, self._speeds, self._speed_start, self._last_score)

    def restore(self, state: TrackerState) -> None:
        """Continue from a saved state."""
        self._fix, self._reference = state.fix, state.reference
        self._fix_stamp = np.inf if state.fix_stamp is None else state.fix_stamp
        self._speeds, self._speed_start, self._last_score = state.speeds, state.speed_start, state.last_score

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
        return bool(self._travel_since_view_change < VIEW_CHANGE_MEMORY)

    def track(self, stamp: float, odometry: se2.Pose, scan: ScanFeatures, target: MatchTarget) -> TrackingResult:
        """Estimate the base's pose at a scan taken when odometry was at `odometry`."""
        score_before, view = self._last_score, View(odometry, scan.points.all)
        result = self._track(stamp, odometry, scan, target)
        if self._odometry is not None:
            self._travel_since_view_change += float(wheel_travel(se2.between(self._odometry, odometry)))
        untracked = result.status in (TrackingStatus.FAILED, TrackingStatus.TENTATIVE)
        if (untracked or self._last_score < score_before - SUSPICIOUS_DROP) and self._view_differs(view):
            self._travel_since_view_change = 0.0
        self._odometry = odometry
        if view.comparable:
            self._view = view
        return replace(result, abrupt=result.abrupt and self.view_changed)

    def _view_differs(self, view: View) -> bool:
        """Return True if a view shows another place than the last one, or if there is no last one.

        False without odometry, as the robot may have driven in between.
        """
        if not self._model.measured:
            return False
        if self._view is None:
            return True
        motion = self._model.correct(se2.between(self._view.odometry, view.odometry))
        return self._view.differs_from(view, motion)

    def _track(self, stamp: float, odometry: se2.Pose, scan: ScanFeatures, target: MatchTarget) -> TrackingResult:
        if self._fix is None or self._reference is None:
            self.move_to(np.zeros(3), odometry)
        assert self._fix is not None
        assert self._reference is not None
        usual = Prediction(
            self._extrapolate(self._reference, odometry), self._information(self._reference, odometry), self._usual_cost
        )
        predictions = [usual, self._slipped(stamp, odometry)]
        if self._tentative is not None:
            pose, information = (
                self._extrapolate(self._tentative, odometry),
                self._information(self._tentative, odometry),
            )
            predictions.append(Prediction(pose, information))
        match = target.match(scan, predictions)
        slipped, confirmed = match.prediction is predictions[1], match.prediction not in predictions[:2]
        prior, fix_pose = match.prediction.information, match.registration.pose
        self._tentative, self._usual_cost = None, 0.0
        if _too_few_features(scan) and len(target.landmarks.walls):
            return self._result(match, TrackingStatus.NO_FEATURES, prior)
        self._untracked_in_a_row += 1
        if not match.plausible or (slipped and match.prediction.squared_distance(fix_pose) > MAX_SLIP**2):
            return self._result(match, TrackingStatus.FAILED, prior)
        fix = PoseFix(fix_pose, odometry)
        if slipped or (confirmed and match.poor):
            self._tentative = fix
            self._usual_cost = min(other.cost for other in match.others if other.prediction is usual) - match.cost
            return self._result(match, TrackingStatus.TENTATIVE, prior)
        self._measure_speed(stamp, odometry, interrupted=confirmed)
        self._fix, self._fix_stamp, self._untracked_in_a_row = fix, stamp, 0
        slipped = confirmed or match.prediction.squared_distance(fix.pose) > KERNEL**2
        if slipped or not self._model.measured:  # odometry continues from here
            self._reference = fix
        return self._result(match, TrackingStatus.TRACKED, prior, slipped=slipped)

    def _slipped(self, stamp: float, odometry: se2.Pose) -> Prediction:
        """Return the prediction if odometry has slipped, stood still or jumped since the last fix.

        The robot has moved from there no faster than it usually moves.
        """
        assert self._fix is not None
        reach = self._speeds * max(0.0, stamp - self._fix_stamp)
        sigmas = np.array([reach[0], reach[0], reach[1]]) + PREDICTION_SIGMAS
        return Prediction(self._fix.pose, np.diag(sigmas**-2.0), SLIP_COST, NO_KERNEL)

    def _measure_speed(self, stamp: float, odometry: se2.Pose, *, interrupted: bool) -> None:
        """Update the speeds that the robot has reached, by odometry; start anew if that has slipped."""
        if interrupted or self._speed_start is None:
            self._speed_start = stamp, odometry
            return
        interval = stamp - self._speed_start[0]
        if interval >= SPEED_INTERVAL:
            x, y, turn = se2.between(self._speed_start[1], odometry)
            self._speeds = np.maximum(self._speeds, np.array([np.hypot(x, y), abs(turn)]) / interval)
            self._speed_start = stamp, odometry

    def _result(
        self, match: ScanMatch, status: TrackingStatus, prior: Floats, *, slipped: bool = False
    ) -> TrackingResult:
        covariance = np.asarray(np.linalg.inv(match.registration.total_information + prior))
        abrupt = status is TrackingStatus.TRACKED and match.score < self._last_score - ABRUPT_DROP
        if status is TrackingStatus.TRACKED:
            self._last_score = match.score
        return TrackingResult(match.registration, status, covariance, slipped, abrupt)

    def _extrapolate(self, fix: PoseFix, odometry: se2.Pose) -> se2.Pose:
        return se2.compose(fix.pose, self._model.correct(fix.odometry_motion(odometry)))

    def _information(self, reference: PoseFix, odometry: se2.Pose) -> Floats:
        """Return the information (3, 3) of the pose predicted from the reference, in the base's frame."""
        covariance = self._model.covariance(reference.odometry_motion(odometry)) + PREDICTION_COVARIANCE
        return np.asarray(np.linalg.inv(covariance))


def _too_few_features(scan: ScanFeatures) -> bool:
    return 2 * scan.segments.half_length.sum() < MIN_WALL_LENGTH and len(scan.points.all) < MIN_POINTS

"""Keeping hold of the robot's pose from scan to scan, also where odometry fails.

Odometry may slip, stand still for a second and then catch up, or jump. A scan that falls neither on known walls nor on
the points of the last keyframes is not believed where odometry puts it: its pose is searched for with the raw points,
and a few scans that fit nowhere are left out before the place is taken for new, or the robot for lost where the map has
been.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..mapping.local_map import LocalMap
from ..matching.likelihood_field import LikelihoodField, likelihood_score, search
from ..matching.line_matcher import NEAR_STARTS, Registration, ScanFeatures, register
from ..odometry.error_model import OdometryModel
from ..odometry.history import wheel_travel
from .view_change import View

# Added to the odometry's own uncertainty when predicting a scan's pose: wheels slip, clocks differ. Metres and radians.
PREDICTION_SIGMAS = np.array([0.05, 0.05, np.radians(4.0)])
EXPLAINED_ENOUGH = 0.5  # share of a scan's wall length on known walls that alone makes a pose believable
FITS_ENOUGH = 0.6  # the same, and the likeness of its points with those of the last keyframes, that together do
CLEARLY_LIKER = 0.1  # by which the points must lie better at a searched pose than at the predicted one
SEARCHED_LIKE = 0.5  # likeness that a searched pose must reach
SEARCHED_POINTS = 30  # points that a scan must have for that: few of them lie well nearly everywhere
LARGE_STEP = 0.8  # metres of way between two scans, from which on odometry may be making up for what it missed
ABRUPTLY_WORSE = 1.0  # by which a scan fits worse than the one before where the view has changed at a stroke
DOUBTFULLY_WORSE = 0.5  # the same, from which on it is looked whether it does
BREAK_REMEMBERED = 10.0  # metres of driving: what looks alike at first fits nowhere some way on
CLEARLY_BETTER = 0.3  # by which the scan must then fit better where the robot last was
UNEVEN, UNEVEN_TURN = 0.1, np.radians(5.0)  # by which odometry's step may differ from the robot's last one unquestioned
BETTER = 0.15  # by which a scan must fit better where the robot is if it has moved as evenly as before
PATIENCE = 4  # scans in a row that may fit nowhere
KNOWN_AROUND = 1.0  # metres around a known wall where the map has been
NEW_PLACE = 0.3  # share of what is seen that lies where the map has been, below which the place is new and nobody lost
LEAST_WALL = 0.5  # metres of wall that a scan must show, or SEARCHED_POINTS, for its pose to be found by it


class TrackingStatus(Enum):
    """How a scan's pose was found."""

    TRACKED = "tracked"  # it fits the map where odometry led to, give or take
    TENTATIVE = "tentative"  # it fits the map elsewhere; nothing enters the path before the next scan bears it out
    FAILED = "failed"  # it fits nowhere near
    NO_FEATURES = "no features"  # it shows too little to be placed by


@dataclass(frozen=True, slots=True, eq=False)
class TrackingResult:
    """Where a scan was taken.

    covariance        (3, 3) of the pose in the map as it stands, in the base's frame
    bears_out_search  whether this scan confirms the pose that was searched for one scan earlier
    abrupt            whether it fits far worse than the scan before it, and the view broke off lately: the robot may
                      have been carried elsewhere
    """

    registration: Registration
    status: TrackingStatus
    covariance: Floats
    bears_out_search: bool
    abrupt: bool

    @property
    def pose(self) -> se2.Pose:
        """The base's pose in the map."""
        return self.registration.pose


@dataclass(frozen=True, slots=True, eq=False)
class PoseFix:
    """A pose of the base in the map and the odometry's pose at the same time."""

    pose: se2.Pose
    odometry: se2.Pose

    def step(self, odometry: se2.Pose) -> se2.Pose:
        """The motion since, as odometry claims it."""
        return se2.between(self.odometry, odometry)


@dataclass(frozen=True, slots=True, eq=False)
class MatchTarget:
    """What a scan is compared with: landmarks, the points of the last keyframes, the variance of walls' unevenness."""

    landmarks: LocalMap
    points: LikelihoodField
    roughness: float

    def match(self, scan: ScanFeatures, prediction: se2.Pose, prior: Floats, starts: Floats = NEAR_STARTS) -> _Fit:
        """Lay a scan over them near a predicted pose."""
        registration = register(prediction, prior, starts, scan, self.landmarks, self.points, self.roughness)
        return _Fit(registration, likelihood_score(self.points, scan.points.all, registration.pose))

    def known_share(self, scan: ScanFeatures, pose: se2.Pose) -> float:
        """Share of a scan's wall length, seen from `pose`, that lies where the map has been: near any known wall."""
        walls, segments = self.landmarks, scan.segments
        middles = se2.transform(pose, segments.frame[:, :2])
        seen = se2.transform(se2.inverse(walls.frame)[:, None], middles[None])  # (walls, segments, 2)
        beyond = np.maximum(0.0, np.maximum(walls.low[:, None] - seen[..., 0], seen[..., 0] - walls.high[:, None]))
        known = np.hypot(beyond, seen[..., 1]).min(axis=0, initial=np.inf) < KNOWN_AROUND
        total = float(segments.half_length.sum())
        return float(segments.half_length[known].sum()) / total if total else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """How a scan lies on walls (`registration.explained`) and on the points of the last keyframes (`like`)."""

    registration: Registration
    like: float

    @property
    def both(self) -> float:
        return self.registration.overlap_ratio + self.like

    @property
    def believable(self) -> bool:
        return self.registration.overlap_ratio >= EXPLAINED_ENOUGH or self.both >= FITS_ENOUGH


class Tracker:
    """The last pose that is believed, and the odometry's at that time."""

    def __init__(self, model: OdometryModel) -> None:
        self._model = model
        self._firm: PoseFix | None = None
        self._step = np.zeros(3)  # from the scan before last to the last
        self._misfits = 0  # scans in a row
        self._last_fit = 0.0  # of the last scan that was placed
        # Where the robot was before its last pose was searched for: odometry may make up for what it missed in a step,
        # and the search may have been wrong.
        self._left: PoseFix | None = None
        self._view: View | None = None  # the last one that can be compared
        self._odometry: se2.Pose | None = None  # at the last scan
        self._since_break = np.inf  # metres driven since a scan showed something else than the one before it

    def move_to(self, pose: se2.Pose, odometry: se2.Pose) -> None:
        """The base is at `pose` in the map, as the map is now, when odometry is at `odometry`."""
        self._firm, self._misfits, self._left = PoseFix(pose, odometry), 0, None

    @property
    def firm(self) -> PoseFix | None:
        """The last pose that is believed; None before the first scan."""
        return self._firm

    @property
    def step(self) -> se2.Pose:
        """The motion that led there."""
        return self._step

    @property
    def fit(self) -> float:
        """How well the last scan lay that was placed."""
        return self._last_fit

    def resume(self, firm: PoseFix, step: se2.Pose, fit: float) -> None:
        """Go on from where another tracker was."""
        self._firm, self._step, self._last_fit = firm, step, fit

    def correct(self, pose: se2.Pose) -> None:
        """The map has changed, and the pose at the last scan with it."""
        assert self._firm is not None
        self._firm = PoseFix(pose, self._firm.odometry)

    def predict(self, odometry: se2.Pose) -> se2.Pose:
        """Where the base is in the map when odometry is at `odometry`."""
        return np.zeros(3) if self._firm is None else self._led(self._firm, odometry)

    @property
    def lost(self) -> bool:
        """Whether too many scans in a row fitted nowhere for the last pose to be still of use."""
        return self._misfits >= PATIENCE

    @property
    def view_changed(self) -> bool:
        """Whether what is seen has changed at a stroke lately."""
        return bool(self._since_break < BREAK_REMEMBERED)

    def track(self, odometry: se2.Pose, scan: ScanFeatures, around: MatchTarget) -> TrackingResult:
        """Where the base was at a scan taken when odometry was at `odometry`."""
        fit, view = self._last_fit, View(odometry, scan.points.all)
        tracking = self._track(odometry, scan, around)
        if self._odometry is not None:
            self._since_break += float(wheel_travel(se2.between(self._odometry, odometry)))
        doubtful = (
            tracking.status in (TrackingStatus.FAILED, TrackingStatus.TENTATIVE)
            or self._last_fit < fit - DOUBTFULLY_WORSE
        )
        if doubtful and self._view_differs(view):
            self._since_break = 0.0
        self._odometry = odometry
        if view.comparable:
            self._view = view
        return replace(tracking, abrupt=tracking.abrupt and self.view_changed)

    def _view_differs(self, view: View) -> bool:
        """Whether the view is another one than the last; a tracker that has seen none cannot rule it out."""
        if self._view is None:
            return True
        motion = self._model.corrected(se2.between(self._view.odometry, view.odometry))
        return self._view.differs_from(view, motion)

    def _track(self, odometry: se2.Pose, scan: ScanFeatures, around: MatchTarget) -> TrackingResult:
        if self._firm is None:
            self.move_to(np.zeros(3), odometry)
        assert self._firm is not None
        prior = self._prior(odometry)
        after_search = self._left is not None
        predictions, leads = self._predictions(odometry)
        fits = [around.match(scan, prediction, prior) for prediction in predictions]
        best = int(np.argmax([fit.both - lead for fit, lead in zip(fits, leads, strict=True)]))
        fit = fits[best]
        bears_out = after_search and best < len(predictions) - 1
        if _shows_too_little(scan) and len(around.landmarks.walls):
            return self._placement(fit, TrackingStatus.NO_FEATURES, prior)
        if fit.believable or not len(around.landmarks.walls):
            self._step = se2.between(self._firm.pose, fit.registration.pose)
            self.move_to(fit.registration.pose, odometry)
            return self._placement(fit, TrackingStatus.TRACKED, prior, bears_out)
        searched = self._search(scan, around, predictions[-1], fit.like)
        if searched is None:
            self._misfits += 1
            if not self.lost or around.known_share(scan, fit.registration.pose) >= NEW_PLACE:
                return self._placement(fit, TrackingStatus.FAILED, prior)
            self.move_to(fit.registration.pose, odometry)
            return self._placement(fit, TrackingStatus.TRACKED, prior)
        far = around.match(scan, searched, prior, NEAR_STARTS[:1])
        left = self._firm
        self.move_to(far.registration.pose, odometry)
        self._left = left
        return self._placement(
            far, TrackingStatus.TRACKED if after_search else TrackingStatus.TENTATIVE, prior, after_search
        )

    def _placement(
        self, fit: _Fit, status: TrackingStatus, prior: Floats, bears_out_search: bool = False
    ) -> TrackingResult:
        covariance = np.asarray(np.linalg.inv(fit.registration.held_by + prior))
        abrupt = status is TrackingStatus.TRACKED and fit.both < self._last_fit - ABRUPTLY_WORSE
        if status in (TrackingStatus.TRACKED, TrackingStatus.TENTATIVE):
            self._last_fit = fit.both
        return TrackingResult(fit.registration, status, covariance, bears_out_search, abrupt)

    def _predictions(self, odometry: se2.Pose) -> tuple[list[se2.Pose], list[float]]:
        """Where the base may be, and by how much better than as odometry has it a scan must fit there.

        That is as odometry has it; where an even motion would have led, if odometry's step is uneven; where the base
        was, if odometry may just be making up for what it missed; and, if the last pose was searched for, as odometry
        has it from where the robot was before.
        """
        assert self._firm is not None
        predictions, leads = [self._led(self._firm, odometry)], [0.0]
        step = self._model.corrected(self._firm.step(odometry))
        unlike = se2.between(self._step, step)
        if np.hypot(unlike[0], unlike[1]) > UNEVEN or abs(unlike[2]) > UNEVEN_TURN:
            predictions.append(se2.compose(self._firm.pose, self._step))
            leads.append(BETTER)
        if self._left is not None:
            return [*predictions, self._firm.pose, self._led(self._left, odometry)], [*leads, 0.0, 0.0]
        if wheel_travel(step) > LARGE_STEP:
            return [*predictions, self._firm.pose], [*leads, CLEARLY_BETTER]
        return predictions, leads

    def _led(self, place: PoseFix, odometry: se2.Pose) -> se2.Pose:
        return se2.compose(place.pose, self._model.corrected(place.step(odometry)))

    def _search(self, scan: ScanFeatures, around: MatchTarget, near: se2.Pose, like: float) -> se2.Pose | None:
        """A pose where the scan's points lie clearly better than they do (`like`) where it was expected."""
        if len(scan.points.all) < SEARCHED_POINTS:
            return None
        searched, liker = search(around.points, scan.points.all, near)
        return searched if liker >= max(SEARCHED_LIKE, like + CLEARLY_LIKER) else None

    def _prior(self, odometry: se2.Pose) -> Floats:
        """(3, 3): information of the pose predicted with `odometry`, in the base's frame."""
        assert self._firm is not None
        return np.asarray(
            np.linalg.inv(self._model.covariance(self._firm.step(odometry)) + np.diag(PREDICTION_SIGMAS**2))
        )


def _shows_too_little(scan: ScanFeatures) -> bool:
    return 2 * scan.segments.half_length.sum() < LEAST_WALL and len(scan.points.all) < SEARCHED_POINTS

"""Relocalise a lost or kidnapped robot: map its surroundings separately until they are recognised in the map.

A robot is lost after it was kidnapped, or after odometry has drifted while no scan fitted. Its scans then build a small
map in a frame of their own, and nothing enters the old map. Once the place is recognised, these scans are processed
again from the recognised pose.

Places may look alike. A kidnapped robot, whose view changed abruptly, may be anywhere. Any other robot is within the
uncertainty of odometry: if it is not recognised there, its place is new.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers import se2

from ..config import Config
from ..localisation.tracker import TrackingResult, TrackingStatus
from ..loop_closure.look import MAX_SQUARED_DISTANCE, UNMODELLED_SIGMAS
from ..loop_closure.relocalisation import Relocalisation, index_map, relocalise, submap_of
from ..preprocessing.preprocessor import ProcessedScan
from .estimator import Estimator
from .slam_state import SlamState

# Keyframes and metres of driving between two attempts. Origin: chosen;
# not measured.
ATTEMPT_KEYFRAMES = 3
ATTEMPT_DISTANCE = 1.0  # Origin: as ATTEMPT_KEYFRAMES.
# Attempts in a row that must find the same place if alternatives are close behind.
# Origin: chosen; no measurement recorded.
CONFIRMING_ATTEMPTS = 4
# Metres and radians by which these attempts may differ. Origin: chosen; not measured.
AGREEMENT_DISTANCE = 0.3
AGREEMENT_TURN = math.radians(3.0)  # Origin: as AGREEMENT_DISTANCE.
# Metres of driving for which a possible kidnapping is examined. Origin: chosen; not measured.
KIDNAPPING_DISTANCE = 10.0
# Overlap ratio by which another place must exceed the tracked one. Origin: chosen; not measured.
MIN_OVERLAP_GAIN = 0.05
# Metres of driving in which a robot that was not kidnapped must be recognised near odometry's pose.
# Origin: chosen; not measured.
MAX_SEARCH_DISTANCE = 10.0
# Share of the scans that must fit the map at the recognised place. Origin: chosen; not measured.
MIN_TRACKED_SHARE = 0.8


class RelocalisationSession:
    """Scans since the robot got lost, and the small map that they build.

    `whole` is the state before that. It is never changed: the result is a new estimator. `kidnapped` is True if the
    robot may have been moved without odometry noticing.
    """

    def __init__(self, config: Config, whole: SlamState, scans: Sequence[ProcessedScan], *, kidnapped: bool) -> None:
        self._config = config
        self._whole, self._kidnapped = whole, kidnapped
        self._index = index_map(whole.mapper)
        self._start(scans)

    def _start(self, scans: Sequence[ProcessedScan]) -> None:
        self._estimator = Estimator(SlamState(self._config))
        self._last_attempt_keyframe, self._last_attempt_distance = 0, -ATTEMPT_DISTANCE
        self._agreeing: list[se2.Pose] = []  # poses of the session's frame in the map, of the last attempts in a row
        self.scans: list[ProcessedScan] = []
        self.overlap_ratios: list[float] = []  # of the scans at the last recognised place
        for scan in scans:
            self.add(scan)

    def add(self, scan: ProcessedScan) -> None:
        """Add a scan. If tracking is lost in the small map too, start again from the last scans."""
        self._estimator.process(scan)
        self.scans.append(scan)
        state = self._estimator.state
        if state.lost:
            self._kidnapped = self._kidnapped or state.view_changed
            self._start(state.untracked_scans)

    @property
    def travelled(self) -> float:
        """Metres driven in this session."""
        return self._estimator.state.mapper.travelled[-1]

    @property
    def pose(self) -> se2.Pose:
        """Pose of the base in the map according to odometry alone."""
        return self._whole.predict(self.scans[-1].odometry)

    @property
    def over(self) -> bool:
        """True if the robot is where odometry has it, and this place is not in the map."""
        return not self._kidnapped and not self._whole.frozen and self.travelled > MAX_SEARCH_DISTANCE

    def attempt(self) -> Estimator | None:
        """Try to recognise the place.

        Returns the whole map with this session's scans at the recognised place; None if it is not recognised yet, or if
        the last attempt was too recent.
        """
        mapper = self._estimator.state.mapper
        keyframes, travelled = mapper.keyframe_count, mapper.travelled[-1]
        if (
            keyframes - self._last_attempt_keyframe < ATTEMPT_KEYFRAMES
            or travelled - self._last_attempt_distance < ATTEMPT_DISTANCE
        ):
            return None
        self._last_attempt_keyframe, self._last_attempt_distance = keyframes, travelled
        found = relocalise(submap_of(mapper), self._index)
        if found is None or not self._is_confirmed(found) or not self._is_reachable(found):
            return None
        return self._continue_at(found.motion)

    def _is_reachable(self, found: Relocalisation) -> bool:
        """Return True if the robot can be there: a kidnapped robot anywhere, another one as far as odometry errs."""
        if self._kidnapped:
            return True
        odometry = self.scans[0].odometry
        last_seen = self._whole.mapper.landmarks.walls.rows["last_seen"][found.pairs[:, 0]]
        covariance = self._whole.covariance_since(int(np.bincount(last_seen).argmax()), odometry)
        covariance = covariance + np.diag(UNMODELLED_SIGMAS**2)
        error = se2.between(self._whole.predict(odometry), found.motion)
        return bool(error @ np.linalg.solve(covariance, error) < MAX_SQUARED_DISTANCE)

    def _is_confirmed(self, found: Relocalisation) -> bool:
        """Return True if the place is accepted at once, or was the best one in several attempts in a row."""
        differences = [se2.between(before, found.motion) for before in self._agreeing]
        agrees = all(np.hypot(x, y) < AGREEMENT_DISTANCE and abs(turn) < AGREEMENT_TURN for x, y, turn in differences)
        self._agreeing = [*(self._agreeing if agrees else []), found.motion] if found.verdict.plausible else []
        return found.verdict.accepted or len(self._agreeing) >= CONFIRMING_ATTEMPTS

    def _continue_at(self, motion: se2.Pose) -> Estimator | None:
        """Process the session's scans in the whole map from a recognised pose; None if they do not fit there."""
        state = self._whole.copy()
        state.move_to(motion, self.scans[0].odometry)  # the session's frame is that of its first scan
        estimator, results = self._process_scans(state)
        self.overlap_ratios = [result.registration.overlap_ratio for result in results]
        fitting = sum(result.status is not TrackingStatus.FAILED for result in results)
        return estimator if fitting >= MIN_TRACKED_SHARE * len(results) and not estimator.state.lost else None

    def continue_by_odometry(self) -> Estimator:
        """Process the session's scans in the whole map from the pose that odometry predicts.

        The covariances contain the uncertainty of that pose.
        """
        state = self._whole.copy()
        state.start_new_area(self.scans[0].odometry, kidnapped=self._kidnapped)
        return self._process_scans(state)[0]

    def _process_scans(self, state: SlamState) -> tuple[Estimator, list[TrackingResult]]:
        estimator = Estimator(state)
        return estimator, [estimator.process(scan).tracking for scan in self.scans]


class KidnappingMonitor:
    """Check whether the robot was kidnapped to a place that looks like the tracked one.

    It starts when the view has changed abruptly. Tracking continues; if the scans since then are recognised at another
    place and fit better there, the robot is there.
    """

    def __init__(self, config: Config, before: SlamState) -> None:
        self._session = RelocalisationSession(config, before, (), kidnapped=True)
        self._overlap_ratios: list[float] = []  # at the tracked place

    def add(self, scan: ProcessedScan, tracking: TrackingResult) -> None:
        """Add a scan and its tracking result."""
        self._session.add(scan)
        self._overlap_ratios.append(tracking.registration.overlap_ratio)

    @property
    def over(self) -> bool:
        """True if the robot has driven far enough without being recognised elsewhere."""
        return self._session.travelled > KIDNAPPING_DISTANCE

    def attempt(self) -> Estimator | None:
        """Return the map with the scans since the change at another, better place; None if there is none."""
        found = self._session.attempt()
        if found is None:
            return None
        better = np.mean(self._session.overlap_ratios) > np.mean(self._overlap_ratios) + MIN_OVERLAP_GAIN
        return found if better else None

"""Decide from the next scans if the robot has left the part of the map that it was in.

A scan that does not fit begins a new part of the map at once, but one scan is weak evidence: people who stand around
the robot change the view as much as being carried does. So the state from before is kept, and tracks the next scans as
well. In the right part of the map nearly each scan fits where odometry predicts it, elsewhere nearly none. The
sequential test of Wald for two such probabilities p and 1 - p counts the scans that fit minus those that do not; it
is decided at a margin n with an error probability of about ((1 - p) / p)^n. Only scans at least CLOSE_SHARE of the
distance between keyframes apart count: those of a robot that stands repeat each other. While the robot stands, the test
goes on for as many scans as a closure is monitored.

These probabilities are those of poses that odometry predicts. If tracking finds a pose elsewhere by search, as after a
slip, the next scans may fit there one after the other, as in a look-alike corridor. So a scan counts as fitting only if
its pose agrees with odometry since the robot was last seen in the part.

If the new part is recognised in the map where odometry has the robot, the robot has not left either.

Tracking also accepts scans of which only half of the points fit, as among people. Where little of the map is in view,
scans from another place may fit as well as that, one after the other. So a poor fit does not count.
"""

from __future__ import annotations

import numpy as np

from drivers import se2
from drivers.messages import Odometry
from drivers.small_matrices import inverse

from ..geometry.surroundings import INDOOR_RANGE
from ..localisation.prediction_error import PREDICTION_SIGMAS
from ..localisation.tracking import TrackingResult, TrackingStatus
from ..loop_closure.submap_search import are_distinct
from ..matching.point_matcher import MIN_KNOWN_POINTS, Prediction
from ..odometry.history import wheel_travel
from ..preprocessing.preprocessor import ProcessedScan
from .closure_monitor import MONITORED_SCANS, ClosureMonitor
from .keyframe_selection import CLOSE_SHARE
from .scan_update import extend_trajectory, track
from .slam_state import SlamState
from .stage_timer import StageTimer

# Difference between the numbers of scans that fit and of those that do not at which the test ends. Origin: Wald's test,
# with an error probability of 1e-4: of the scans of five recordings 95 to 99 % fit as odometry predicts, and of scans
# from elsewhere in the same building 0 to 5 %.
DECIDING_MARGIN = 3
# Metres of driving after which the test ends: the map of the earlier part does not extend farther. People may surround
# the robot for most of this way, so the test is not lost before. Origin: definition.
MAX_TEST_DISTANCE = INDOOR_RANGE


class EarlierPart:
    """State before a part of the map began, in which the robot may still be.

    state    with the poses of the scans since then; its map does not grow, so only the map from before is tested
    monitor  of its recent loop closures
    """

    def __init__(self, state: SlamState, monitor: ClosureMonitor) -> None:
        assert state.tracker.fix is not None
        self.state, self.monitor = state, monitor
        self._last_seen = state.tracker.fix
        self._balance, self._scans, self._travelled = 0, 0, 0.0  # metres
        self._recognised = False
        self._counted: se2.Pose | None = None  # odometry at the last scan that was counted

    def add(self, scan: ProcessedScan) -> TrackingResult | None:
        """Track a scan in the earlier part.

        Once the robot seems to be elsewhere, scans that would not count are left out, and the result is None. Most of
        the time of a lost robot would be spent on searching poses for scans that fit nowhere.
        """
        self._scans += 1
        if self._balance == -DECIDING_MARGIN and not self._is_far_enough(scan.odometry):
            self.monitor.record(scan)
            return None
        tracking = track(self.state, scan, StageTimer())
        self.state.untracked_scans, self.state.tentative = [], []  # no part begins with them
        extend_trajectory(self.state, scan.stamp, tracking)
        self.monitor.record(scan)
        self._count(self._evidence(tracking, scan.reading), scan.odometry)
        return tracking

    def _evidence(self, tracking: TrackingResult, odometry: Odometry) -> int:
        """Return 1 if a scan fits well where odometry predicts it, -1 if it does not fit there, 0 if undecided."""
        if tracking.status is TrackingStatus.NO_FEATURES or tracking.known < MIN_KNOWN_POINTS:
            return 0
        if tracking.status is not TrackingStatus.TRACKED or tracking.slipped:
            return -1
        if not self._agrees_with_odometry(tracking.pose, odometry):
            return -1
        return 0 if tracking.poor else 1

    def _agrees_with_odometry(self, pose: se2.Pose, odometry: Odometry) -> bool:
        """Return True if odometry since the robot was last seen in the part leads to about `pose`.

        True also without odometry, whose motions are those between the poses of the new part.
        """
        motion, covariance = self.state.dead_reckoning.motion_and_covariance(self._last_seen.odometry, odometry)
        information = inverse(covariance + np.diag(PREDICTION_SIGMAS**2))
        predicted = Prediction(se2.compose(self._last_seen.pose, motion), information)
        return not self.state.odometry_model.measured or not predicted.excludes(pose)

    def recognise(self, pose: se2.Pose, odometry: Odometry) -> bool:
        """Confirm the part, and return True, if the robot was recognised in the map where it is in the part.

        Odometry that knows little of the motion agrees with many poses: then the robot would go on at another one.
        """
        expected = self.state.tracker.predict(odometry)
        self._recognised = not are_distinct(expected, pose) and self._agrees_with_odometry(pose, odometry)
        return self._recognised

    def _count(self, evidence: int, odometry: se2.Pose) -> None:
        """Add the evidence of a scan if the robot has driven the smaller distance of keyframes since the last one."""
        if not evidence or not self._is_far_enough(odometry):
            return
        self._travelled += self._travel(odometry)
        self._balance = max(self._balance + evidence, -DECIDING_MARGIN)
        self._counted = odometry

    def _is_far_enough(self, odometry: se2.Pose) -> bool:
        """Return True if a scan is far enough from the last one that was counted."""
        distance = CLOSE_SHARE * self.state.config.mapping.keyframe_distance
        return self._counted is None or self._travel(odometry) >= distance

    def _travel(self, odometry: se2.Pose) -> float:
        """Return the distance driven since the last scan that was counted, metres; zero if there is none."""
        return 0.0 if self._counted is None else float(wheel_travel(se2.between(self._counted, odometry)))

    @property
    def confirmed(self) -> bool:
        """True if the robot has not left the part."""
        return self._recognised or self._balance >= DECIDING_MARGIN

    @property
    def expired(self) -> bool:
        """True if the test ends undecided.

        The robot has driven beyond the map of the part, whether it had left the part before or not, or stands for long.
        """
        return self._travelled > MAX_TEST_DISTANCE or self._scans > MONITORED_SCANS

"""Decide from the next scans if the robot has left the part of the map that it was in.

A scan that does not fit begins a new part of the map at once, but one scan is weak evidence: people who stand around
the robot change the view as much as being carried does. So the state from before is kept, and tracks the next scans as
well. In the right part of the map nearly each scan fits where odometry predicts it, elsewhere nearly none. The
sequential test of Wald for two such probabilities p and 1 - p counts the scans that fit minus those that do not; it
ends at a margin n with an error probability of about ((1 - p) / p)^n.
"""

from __future__ import annotations

from ..localisation.tracking import TrackingResult, TrackingStatus
from ..matching.point_matcher import MIN_KNOWN_POINTS
from ..preprocessing.preprocessor import ProcessedScan
from .closure_monitor import ClosureMonitor
from .scan_update import track, update_map
from .slam_state import SlamState
from .stage_timer import StageTimer

# Scans by which those that fit exceed those that do not, or the reverse, when the test ends. Origin: Wald's test, with
# an error probability of 1e-4: of the scans of five recordings 95 to 99 % fit as odometry predicts, and of scans from
# elsewhere in the same building 0 to 5 %.
DECIDING_MARGIN = 3


class EarlierPart:
    """State before a part of the map began, in which the robot may still be.

    state    continued with the scans since then
    monitor  of its recent loop closures
    """

    def __init__(self, state: SlamState, monitor: ClosureMonitor) -> None:
        self.state, self.monitor = state, monitor
        self._balance = 0

    def add(self, scan: ProcessedScan) -> TrackingResult:
        """Track a scan in the earlier part, and map it there."""
        tracking = track(self.state, scan, StageTimer())
        update_map(self.state, scan, tracking, StageTimer())
        self.monitor.record(scan)
        self._balance += _evidence(tracking)
        return tracking

    @property
    def holds(self) -> bool:
        """True if the robot has not left the part."""
        return self._balance >= DECIDING_MARGIN

    @property
    def left(self) -> bool:
        """True if the robot has left the part."""
        return self._balance <= -DECIDING_MARGIN


def _evidence(tracking: TrackingResult) -> int:
    """Return 1 if a scan fits where odometry predicts it, -1 if it does not, 0 if it shows too little to tell."""
    if tracking.status is TrackingStatus.NO_FEATURES or tracking.known < MIN_KNOWN_POINTS:
        return 0
    return 1 if tracking.status is TrackingStatus.TRACKED and not tracking.slipped else -1

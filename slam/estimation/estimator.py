"""How a belief grows by sightings, with loops closed on trial, and taken back where what follows contradicts them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..localisation.tracker import TrackingResult
from ..loop_closure.closer import LoopDecision
from ..mapping.keyframes import KeyframeObservations
from ..mapping.mapper import Mapper
from ..preprocessing.preprocessor import ProcessedScan
from ..run_statistics import StageTimer
from .closure_monitor import ClosureMonitor
from .slam_state import KeyframeUpdate, SlamState


@dataclass(frozen=True, slots=True, eq=False)
class ScanResult:
    """What a sighting did: where it was taken, how it extended the map if it became a keyframe, and the closure that
    had to be taken back after it, if any. `mapper` is the map with the sighting, before anything was taken back;
    `before` the belief before a sighting that fits abruptly worse."""

    tracking: TrackingResult
    extension: KeyframeUpdate | None
    mapper: Mapper
    retracted: LoopDecision | None
    before: SlamState | None


class Estimator:
    """Changes a belief as sightings come."""

    def __init__(self, slam_state: SlamState) -> None:
        self.slam_state = slam_state
        self._monitor = ClosureMonitor()

    def take(self, scan: ProcessedScan, timer: StageTimer) -> ScanResult:
        """Place a sighting, let the map grow, close a loop or take one back."""
        tracking = self.slam_state.place(scan, timer)
        before = self.slam_state.copy() if tracking.abrupt else None
        extension = self.slam_state.extend(scan, tracking, timer)
        self._monitor.remember(scan)  # before a closure: the belief that it is tried on has the sighting
        if extension is not None and extension.loop is not None and extension.loop.status == "agreed":
            superseded, loop = self.slam_state.mapper, self._close(extension.view, extension.loop)
            extension = replace(extension, loop=loop, superseded=superseded if loop.status == "accepted" else None)
            timer.lap("closing")
        mapper = self.slam_state.mapper
        return ScanResult(tracking, extension, mapper, self._doubt(), before)

    def _close(self, view: KeyframeObservations, decision: LoopDecision) -> LoopDecision:
        """Close the loop that two looks agree on, on a copy, and see whether the map comes together."""
        trial = self.slam_state.copy()
        decision = trial.close_loop(view, decision)
        if decision.status == "accepted":
            self._monitor.begin(self.slam_state, decision)
            self.slam_state = trial
        return decision

    def _doubt(self) -> LoopDecision | None:
        """Take back a closure that was contradicted since: the belief before it takes all sightings since again."""
        closure = self._monitor.examine(self.slam_state.mapper, lost=self.slam_state.lost)
        if closure is None:
            return None
        self.slam_state = closure.checkpoint
        self.slam_state.loops.refuse(closure.decision)
        for scan in closure.since:
            self.slam_state.extend(scan, self.slam_state.place(scan, StageTimer()), StageTimer())
        return closure.decision

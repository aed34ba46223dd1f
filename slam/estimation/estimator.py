"""Process scans one by one: track, map, close loops on trial, and retract closures that later scans contradict."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..localisation.tracker import TrackingResult
from ..loop_closure.decision import LoopDecision
from ..loop_closure.loop_status import LoopStatus
from ..mapping.mapper import Mapper
from ..preprocessing.preprocessor import ProcessedScan
from .closure_monitor import ClosureMonitor
from .scan_update import KeyframeUpdate, close_loop, track, update_map
from .slam_state import SlamState
from .stage_timer import StageTimer


@dataclass(frozen=True, slots=True, eq=False)
class ScanResult:
    """Effects of one scan.

    tracking    pose of the scan
    update      changes of the map; None if the scan did not become a keyframe
    retracted   closure that was undone because this scan contradicts it, if any
    mapper      map with the scan, before a closure was undone
    checkpoint  state before the scan, if the scan fits abruptly worse than the one before
    """

    tracking: TrackingResult
    update: KeyframeUpdate | None
    retracted: LoopDecision | None
    mapper: Mapper
    checkpoint: SlamState | None


class Estimator:
    """State of the estimate, and the monitor of its recent loop closures."""

    def __init__(self, state: SlamState) -> None:
        self.state = state
        self._monitor = ClosureMonitor()

    def process(self, scan: ProcessedScan, timer: StageTimer | None = None) -> ScanResult:
        """Update the state by one scan. `timer` measures the stages."""
        timer = timer or StageTimer()
        tracking = track(self.state, scan, timer)
        checkpoint = self.state.copy() if tracking.abrupt else None
        update = update_map(self.state, scan, tracking, timer)
        self._monitor.record(scan)  # before a closure, whose checkpoint includes this scan
        if update is not None and update.loop is not None and update.loop.status is LoopStatus.CONFIRMED:
            update = self._close_loop(update, update.loop)
            timer.lap("closing")
        mapper = self.state.mapper
        return ScanResult(tracking, update, self._retract_contradicted_closure(), mapper, checkpoint)

    def _close_loop(self, update: KeyframeUpdate, decision: LoopDecision) -> KeyframeUpdate:
        """Close a confirmed loop on a copy of the state; keep the copy if the map fits together."""
        trial, superseded = self.state.copy(), self.state.mapper
        decision = close_loop(trial, update.observations, decision)
        if decision.status is not LoopStatus.ACCEPTED:
            return replace(update, loop=decision)
        self._monitor.add(self.state, decision)
        self.state = trial
        return replace(update, loop=decision, superseded=superseded)

    def _retract_contradicted_closure(self) -> LoopDecision | None:
        """Undo a closure that later scans contradict: return to its checkpoint and process the scans since again."""
        closure = self._monitor.contradicted(self.state.mapper, lost=self.state.lost)
        if closure is None:
            return None
        self.state = closure.checkpoint
        self.state.loops.exclude(closure.decision.correction)
        for scan in closure.scans:
            update_map(self.state, scan, track(self.state, scan, StageTimer()), StageTimer())
        return closure.decision

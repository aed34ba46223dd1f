"""Monitor accepted loop closures over the next metres, and find the one that later scans contradict."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from drivers import se2

from ..formatting import percent
from ..loop_closure.decision import LoopDecision
from ..loop_closure.loop_status import LoopStatus
from ..loop_closure.occlusion import OLD_DISTANCE, occluded_share, old_walls
from ..mapping.mapper import Mapper
from ..preprocessing.preprocessor import ProcessedScan
from .slam_state import SlamState

# Metres of driving for which a closure is monitored: after it, walls that were seen since are old.
MONITORED_DISTANCE = OLD_DISTANCE
# Metres of driving between two checks. Origin: chosen, ten checks of a closure; not measured.
CHECK_INTERVAL = MONITORED_DISTANCE / 10.0
# Share of the wall length observed since the closure that older walls would have hidden, beyond the share without the
# closure. Origin: measured, on data that are not recorded: doors open and furniture moves, so correct closures
# reach a third.
MAX_ADDED_CONTRADICTION = 0.45
# Checks in a row that must exceed MAX_ADDED_CONTRADICTION: doors and people cause single ones. Origin: chosen; not
# measured.
CONFIRMING_CHECKS = 2
# Scans for which a closure is monitored at most, as the driven distance grows with keyframes only, and a robot that
# stays in familiar places adds none. Origin: chosen, ten minutes of a common lidar; the distance takes some minutes.
MONITORED_SCANS = 5000


@dataclass(slots=True, eq=False)
class MonitoredClosure:
    """An accepted closure.

    checkpoint      state right before the closure
    decision        the accepted decision
    travelled       metres driven up to the closure
    last_check      metres driven up to the last check
    scans           scans since the closure
    contradictions  checks in a row that contradicted the closure
    """

    checkpoint: SlamState
    decision: LoopDecision
    travelled: float
    last_check: float
    scans: list[ProcessedScan] = field(default_factory=list)
    contradictions: int = 0


class ClosureMonitor:
    """Closures of the last metres."""

    def __init__(self) -> None:
        self._closures: list[MonitoredClosure] = []

    def add(self, checkpoint: SlamState, decision: LoopDecision) -> None:
        """Monitor a closure from now on; `checkpoint` is the state right before it."""
        travelled = checkpoint.mapper.travelled[-1]
        self._closures.append(MonitoredClosure(checkpoint, decision, travelled, travelled))

    def record(self, scan: ProcessedScan) -> None:
        """Store a scan: it has to be processed again if a closure is undone.

        By then nothing is read from the graph of a checkpoint any more, whose iSAM2 takes most of its memory.
        """
        for closure in self._closures:
            closure.scans.append(scan)
            closure.checkpoint.mapper.graph.solver.dismiss_isam()

    def contradicted(self, mapper: Mapper, *, lost: bool) -> MonitoredClosure | None:
        """Check the closures; return the oldest contradicted one with its decision retracted, and stop monitoring it.

        lost  true if tracking is lost: then the oldest monitored closure counts as contradicted

        Closures after the contradicted one are not monitored any more, since they are undone with it.
        """
        travelled = mapper.travelled[-1]
        self._closures = [
            c
            for c in self._closures
            if travelled - c.travelled <= MONITORED_DISTANCE and len(c.scans) <= MONITORED_SCANS
        ]
        for position, closure in enumerate(self._closures):
            reason = "tracking was lost after it" if lost else _check(closure, mapper)
            if reason:
                del self._closures[position:]
                closure.decision = replace(closure.decision, status=LoopStatus.RETRACTED, reason=reason)
                return closure
        return None


def _check(closure: MonitoredClosure, mapper: Mapper) -> str:
    """Check a closure if CHECK_INTERVAL has been driven since its last check, and count contradictions in a row.

    A closure is contradicted if segments observed since then would have been hidden behind older walls. Returns the
    reason to retract it, empty if there is none.
    """
    if mapper.travelled[-1] - closure.last_check < CHECK_INTERVAL:
        return ""
    closure.last_check = mapper.travelled[-1]
    travelled = np.array(mapper.travelled)
    # Walls mapped with drift just before the closure may lie anywhere: they do not count.
    walls = old_walls(mapper.landmarks, mapper.pose, travelled, closure.travelled - OLD_DISTANCE)
    views = [
        (mapper.graph.keyframe_pose(k), segments)
        for k, segments in mapper.recent_segments
        if k > closure.decision.keyframe
    ]
    share = occluded_share(np.zeros(3), walls, mapper.landmarks, views)
    undone = se2.inverse(closure.decision.correction)
    without = occluded_share(undone, walls, mapper.landmarks, views)
    contradicts = share > without + MAX_ADDED_CONTRADICTION
    closure.contradictions = closure.contradictions + 1 if contradicts else 0
    if closure.contradictions < CONFIRMING_CHECKS:
        return ""
    return f"{percent(share)} of the walls observed since then would be hidden behind older walls"

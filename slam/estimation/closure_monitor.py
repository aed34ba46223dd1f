"""Closures are believed on probation: what is seen in the next metres may contradict one, and it is taken back.

To take it back means to return to the estimate before it and to take the sightings since again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2

from ..loop_closure.closer import LoopDecision
from ..loop_closure.recent_walls import OLD_WAY, recent_and_reference
from ..loop_closure.verification import contradiction
from ..mapping.mapper import Mapper

if TYPE_CHECKING:
    from ..preprocessing.preprocessor import ProcessedScan
    from .slam_state import SlamState

WAY = 15.0  # metres of driving that a closure is on probation
INTERVAL = 1.5  # metres between two examinations
# Share of the wall length seen since then that old walls would have hidden, beyond what they would have had the loop
# not been closed: doors open, things are moved, and right closures have shown a third.
MORE_SEEN_THROUGH = 0.45
IN_A_ROW = 2  # examinations that must say so: a door opens, a person stands somewhere


@dataclass(slots=True, eq=False)
class MonitoredClosure:
    """A closure on probation, the estimate before it, and what was seen since."""

    checkpoint: SlamState
    decision: LoopDecision
    travel: float
    examined: float
    since: list[ProcessedScan] = field(default_factory=list)
    against: int = 0


class ClosureMonitor:
    """The closures of the last metres."""

    def __init__(self) -> None:
        self._closures: list[MonitoredClosure] = []

    def begin(self, checkpoint: SlamState, decision: LoopDecision) -> None:
        """Watch a closure from now on; `checkpoint` is the estimate right before it."""
        travel = checkpoint.mapper.travelled[-1]
        self._closures.append(MonitoredClosure(checkpoint, decision, travel, travel))

    def remember(self, scan: ProcessedScan) -> None:
        """What has been seen would have to be taken again."""
        for closure in self._closures:
            closure.since.append(scan)

    def examine(self, mapper: Mapper, *, lost: bool) -> MonitoredClosure | None:
        """The oldest closure on probation that cannot be right, its decision taken back; the case ends here.

        `lost` is whether tracking has failed since.
        """
        travel = mapper.travelled[-1]
        self._closures = [closure for closure in self._closures if travel - closure.travel <= WAY]
        for position, closure in enumerate(self._closures):
            reason = "the robot got lost after it" if lost else _seen_through(closure, mapper)
            if reason:
                del self._closures[position:]  # those after it rest on it
                verdict = replace(closure.decision.verdict, accepted=False, reason=reason)
                closure.decision = replace(closure.decision, status="retracted", verdict=verdict)
                return closure
        return None


def _seen_through(closure: MonitoredClosure, mapper: Mapper) -> str:
    """Says so if what was seen since a closure could not have been seen past the old walls, were it right."""
    if mapper.travelled[-1] - closure.examined < INTERVAL:
        return ""
    closure.examined = mapper.travelled[-1]
    travelled = np.array(mapper.travelled)
    _, old = recent_and_reference(mapper.landmarks, mapper.pose, travelled)
    # what was mapped on the drifted way just before the closure may lie wherever that has left it
    first_seen = mapper.landmarks.walls.rows["first_seen"][old.wall_set.walls]
    old = replace(old, left=old.left & (travelled[first_seen] < closure.travel - OLD_WAY))
    views = [(mapper.graph.keyframe_pose(k), seen) for k, seen in mapper.views if k > closure.decision.keyframe]
    share = contradiction(np.zeros(3), old, mapper.landmarks, views)
    without = contradiction(se2.inverse(closure.decision.hypothesis.motion), old, mapper.landmarks, views)
    closure.against = closure.against + 1 if share > without + MORE_SEEN_THROUGH else 0
    return f"{share:.0%} of what was seen since lies behind old walls" if closure.against >= IN_A_ROW else ""

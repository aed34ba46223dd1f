"""Update the state by loops: search for them after a keyframe, close them, and link keyframes of one place."""

from __future__ import annotations

import numpy as np

from ..loop_closure import closing
from ..loop_closure.decision import LoopDecision
from ..loop_closure.loop_status import LoopStatus
from ..mapping.keyframes import KeyframeObservations
from ..recognition.loop_evidence import check_evidence
from .slam_state import SlamState


def search_loop(state: SlamState) -> LoopDecision | None:
    """Return the decision to close a loop after a keyframe, or to join parts of the map, if there is one."""
    decision = _search_connected(state) if state.config.loop_closure.enabled else None
    return decision or _search_join(state)


def search_last_loop(state: SlamState) -> LoopDecision | None:
    """Return the decision to close a loop at the end of a run, if there is one."""
    return _search_connected(state, ended=True) if state.config.loop_closure.enabled else None


def _search_connected(state: SlamState, *, ended: bool = False) -> LoopDecision | None:
    """Return the decision to close a loop in the connected part of the map, if there is one; `ended` if the run has."""
    mapper, field = state.mapper, state.local_field
    among = mapper.landmarks.parts.connected(np.arange(mapper.keyframe_count))
    decision = state.loops.search(mapper, field, among, ended=ended)
    if state.loops.correction_likely:
        mapper.free_space_evidence.suspend(mapper.travelled[-1])
    if decision is None:
        if (match := state.loops.return_at(mapper.keyframe_count - 1)) is not None:
            closing.add_return(mapper, match)
        return None
    decision = check_evidence(mapper, field, decision, among)
    if decision.status is LoopStatus.REJECTED:
        state.loops.note_rejection(decision)
        return None
    return decision


def _search_join(state: SlamState) -> LoopDecision | None:
    """Return the decision to join the last part of the map with another one, if it is recognised there."""
    if not state.mapper.landmarks.parts.apart:
        return None
    decision = state.joins.search(state.mapper, state.local_field)
    return None if decision is None else state.loops.number(decision)


def close_loop(state: SlamState, observations: KeyframeObservations | None, decision: LoopDecision) -> LoopDecision:
    """Close a confirmed loop right after the last keyframe; returns the final decision.

    observations  of the last keyframe; None at the end of a run, where no local map is needed any more

    If that is a rejection, the map does not fit together and the state must be discarded: try it on a copy.
    """
    decision = closing.close_loop(state.mapper, decision)
    if decision.status is LoopStatus.ACCEPTED:
        state.mapper.gauge.hold(state.mapper)
        state.loops.clear()
        state.joins.clear()
        state.local_field.link(decision.old, decision.keyframe)
        for match in decision.matches:
            state.local_field.link(match.old, match.keyframe)
        state.mapper.free_space_evidence.clear()
        state.move_to_last_keyframe(observations)
    return decision

"""Update the state with a plan after a keyframe: move to its frame when recognised, then let it support walls."""

from __future__ import annotations

from ..mapping.keyframes import KeyframeObservations
from .slam_state import SlamState


def update_by_plan(state: SlamState, observations: KeyframeObservations) -> bool:
    """Use the plan right after the keyframe of `observations`; return True if the map was moved to its frame."""
    if state.plan is None or not state.plan.update(state.mapper, state.local_field):
        return False
    state.loops.clear()
    state.joins.clear()
    state.mapper.free_space_evidence.clear()
    state.move_to_last_keyframe(observations)
    return True

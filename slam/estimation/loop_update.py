"""Update the state by loops: search for them after a keyframe, close them, and link keyframes of one place."""

from __future__ import annotations

import numpy as np

from ..geometry.segments import Floats
from ..localisation.prediction_error import PREDICTION_SIGMAS
from ..loop_closure import closing
from ..loop_closure.decision import LoopDecision
from ..loop_closure.loop_status import LoopStatus
from ..mapping.keyframes import KeyframeObservations
from ..matching.distance_field import DistanceField
from ..matching.offset_tiles import MAX_DISTANCE
from ..matching.point_matcher import KERNEL, MIN_KNOWN_POINTS, Prediction, match_points
from ..recognition.loop_evidence import check_evidence
from .slam_state import SlamState

# Metres and radians: standard deviations of the pose of a new scan relative to an old one up to which it is matched to
# both. Origin: definition, a third of what Gauss-Newton on the distance field corrects: MAX_DISTANCE, and that at 4 m.
MAX_LINK_SIGMA = MAX_DISTANCE / 3.0
MAX_LINK_TURN_SIGMA = MAX_LINK_SIGMA / 4.0  # Origin: as MAX_LINK_SIGMA.
LINK_SIGMAS = np.array([MAX_LINK_SIGMA, MAX_LINK_SIGMA, MAX_LINK_TURN_SIGMA])  # Origin: definition.


def search_loop(state: SlamState) -> LoopDecision | None:
    """Return the decision to close a loop after a keyframe, or to join parts of the map, if there is one."""
    decision = _search_connected(state) if state.config.loop_closure.enabled else None
    return decision or _search_join(state)


def _search_connected(state: SlamState) -> LoopDecision | None:
    """Return the decision to close a loop in the connected part of the map, if there is one."""
    mapper, field = state.mapper, state.local_field
    among = mapper.landmarks.parts.connected(np.arange(mapper.keyframe_count))
    decision = state.loops.search(mapper, field, among)
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


def close_loop(state: SlamState, observations: KeyframeObservations, decision: LoopDecision) -> LoopDecision:
    """Close a confirmed loop right after the keyframe of `observations`; returns the final decision.

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
        state.local_map = state.mapper.local_map(observations)
        state.move_to_last_keyframe()
    return decision


def link_revisited(state: SlamState) -> None:
    """Link the last keyframe with the nearest one that the distance field lacks, if their relative pose is well known.

    That is, if Gauss-Newton would find the pose of the new scan among the points of the old one, and does not find
    another one there. Else the next scans would be pulled from the path to the old points, and odometry would seem to
    have failed, while it is a loop that has to be closed.
    """
    mapper, last = state.mapper, state.mapper.keyframe_count - 1
    connected = mapper.landmarks.parts.connected(np.arange(last + 1))
    old = state.local_field.nearest_missing(mapper.keyframe_poses, last, connected)
    if old is None:
        return
    # The bound costs nothing, and is small enough in most places.
    well_known = _is_well_known(mapper.covariances.relative_bound(old, last, stored=True)) or _is_well_known(
        mapper.covariances.relative(old, last)
    )
    if well_known and not _fits_elsewhere(state, old):
        state.local_field.link(old, last)


def _fits_elsewhere(state: SlamState, old: int) -> bool:
    """Return True if the last keyframe fits the points around an old one at another pose than that in the map."""
    poses, last = state.mapper.keyframe_poses, state.mapper.keyframe_count - 1
    around, points = state.local_field.missing_around(old, state.mapper.travelled), state.local_field.points(last)
    field = DistanceField.empty(poses[last])
    field.insert_scans(poses[around], state.local_field.points_of(around))
    possible = Prediction(poses[last], np.diag(LINK_SIGMAS**-2.0))
    match = match_points(field, points, [possible], exhaustive=True)[0]
    if match.known < MIN_KNOWN_POINTS or match.poor:
        return False
    expected = Prediction(poses[last], np.diag(PREDICTION_SIGMAS**-2.0))
    return expected.squared_distance(match.pose) > KERNEL**2


def _is_well_known(covariance: Floats) -> bool:
    """Return True if scans of two keyframes can be matched, given the covariance (3, 3) of their relative pose."""
    position = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    return position < MAX_LINK_SIGMA and bool(np.sqrt(covariance[2, 2]) < MAX_LINK_TURN_SIGMA)

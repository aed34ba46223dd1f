"""Search the whole session again, on the refined map, for loops that were missed online, and close them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers import se2

from ...geometry.segments import Integers
from ...loop_closure.closing import LOOP_FACTOR_SIGMAS, MIN_COINCIDING_SHARE, find_misassociated_walls, walls_coincide
from ...loop_closure.decision import LoopDecision
from ...loop_closure.loop_search import LoopSearch
from ...loop_closure.loop_status import LoopStatus
from ...mapping.keyframes import KeyframeMotion
from ...mapping.map_replay import replay
from ...mapping.mapper import Mapper
from .scan_history import ScanHistory


@dataclass(frozen=True, slots=True, eq=False)
class MissedLoop:
    """A loop that was not closed.

    misassociated  (n,) ids of old walls with which keyframes from `since` on were wrongly associated
    """

    decision: LoopDecision
    misassociated: Integers
    since: int


def find_missed_loop(mapper: Mapper, history: ScanHistory) -> MissedLoop | None:
    """Return the first confirmed loop of the session that is not closed on this map."""
    search = LoopSearch()
    for past in replay(mapper, (history.scans[row].features.segments for row in history.keyframes)):
        decision = search.search(past)
        if decision is not None and decision.status == LoopStatus.CONFIRMED:
            return MissedLoop(decision, *find_misassociated_walls(past, decision))
    return None


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """The map after a loop closure, and the decision."""

    mapper: Mapper
    decision: LoopDecision


def close_missed_loop(
    mapper: Mapper, history: ScanHistory, motions: Sequence[KeyframeMotion | None], missed: MissedLoop
) -> ClosedLoop | None:
    """Close a loop: solve with a loop factor for its last keyframe, and merge the walls that coincide then.

    Returns None if too few of them coincide. Observations of misassociated walls are left out; the next iteration
    associates them again and needs no loop factor, because the walls are merged.
    """
    decision, poses = missed.decision, mapper.keyframe_poses
    last = decision.keyframe
    relative = se2.between(poses[decision.old], se2.compose(decision.hypothesis.motion, poses[last]))
    new = Mapper.with_landmarks_of(mapper)
    new.landmarks.unconfirm_all()
    for k, (row, landmark_ids) in enumerate(zip(history.keyframes, mapper.landmark_ids, strict=True)):
        misassociated = np.isin(landmark_ids.walls, missed.misassociated) & (missed.since <= k <= last)
        features = history.scans[row].features
        new.add_keyframe_with_ids(
            poses[k],
            motions[k],
            features.segments,
            features.corners,
            replace(landmark_ids, walls=np.where(misassociated, -1, landmark_ids.walls)),
        )
    new.graph.add_loop(decision.old, last, relative, LOOP_FACTOR_SIGMAS)
    new.solve()
    rows = new.landmarks.walls.rows
    merged = [(old, recent) for old, recent in decision.pairs if walls_coincide(rows[old], rows[recent])]
    if len(merged) < MIN_COINCIDING_SHARE * len(decision.pairs):
        return None
    for old, recent in merged:
        if rows["merged_into"][old] == old and rows["merged_into"][recent] == recent:
            new.landmarks.merge_walls(old, recent)
    shift = float(np.hypot(*(new.keyframe_poses[last] - poses[last])[:2]))
    return ClosedLoop(new, replace(decision, status=LoopStatus.ACCEPTED, merged=tuple(merged), shift=shift))

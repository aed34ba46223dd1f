"""Loops that the first look missed: the whole drive once more, on the map as it is known now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers import se2

from ...geometry.segments import Integers
from ...loop_closure.closer import (
    CARRYING_SIGMAS,
    LEAST_MERGED,
    LoopCloser,
    LoopDecision,
    misassociated_walls,
    together,
)
from ...mapping.keyframes import Motion
from ...mapping.mapper import Mapper
from .scan_history import ScanHistory


@dataclass(frozen=True, slots=True, eq=False)
class Missed:
    """A closure that was missed, and the `strangers` (n,): walls that the pass `since` a keyframe took for others."""

    decision: LoopDecision
    strangers: Integers
    since: int


def missed_closure(mapper: Mapper, history: ScanHistory) -> Missed | None:
    """The first loop along the drive that two looks agree on and that is not closed on this map."""
    past, closer = Mapper.on(mapper), LoopCloser()
    past.graph, past.correlated_drift = mapper.graph, mapper.correlated_drift
    walls = past.landmarks.walls.rows
    confirmed = walls["in_graph"].copy()
    walls["in_graph"], walls["observations"], walls["first_seen"], walls["last_seen"] = False, 0, 0, 0
    for k, (row, landmark_ids) in enumerate(zip(history.keyframes, mapper.landmark_ids, strict=True)):
        seen = np.unique(landmark_ids.walls[landmark_ids.walls >= 0])
        walls["first_seen"][seen] = np.where(walls["observations"][seen] == 0, k, walls["first_seen"][seen])
        walls["observations"][seen] += 1
        walls["last_seen"][seen] = k
        walls["in_graph"][seen] = confirmed[seen] & (walls["observations"][seen] > 1)
        past.keyframe_count, past.keyframe_poses, past.travelled = (
            k + 1,
            mapper.keyframe_poses[: k + 1],
            mapper.travelled[: k + 1],
        )
        past.views.append((k, history.scans[row].features.segments))
        decision = closer.search(past)
        if decision is not None and decision.status == "agreed":
            return Missed(decision, *misassociated_walls(past, decision))
    return None


@dataclass(frozen=True, slots=True, eq=False)
class Closed:
    """The map with a loop closed, and the decision that did it."""

    mapper: Mapper
    decision: LoopDecision


def carried_over(
    mapper: Mapper, history: ScanHistory, motions: Sequence[Motion | None], missed: Missed
) -> Closed | None:
    """The map with a loop closed: its last keyframe brought to where the decision has it, and walls made one.

    None where too few of them come together. What drift has confused since the robot came to the place is left out;
    the next round associates it anew, and holds the map together without the relative pose that brought it there.
    """
    decision, poses = missed.decision, mapper.keyframe_poses
    last = decision.keyframe
    relative = se2.between(poses[decision.old], se2.compose(decision.hypothesis.motion, poses[last]))
    new = Mapper.on(mapper)
    new.landmarks.walls.rows["in_graph"] = new.landmarks.corners.rows["in_graph"] = False
    for k, (row, landmark_ids) in enumerate(zip(history.keyframes, mapper.landmark_ids, strict=True)):
        strange = np.isin(landmark_ids.walls, missed.strangers) & (missed.since <= k <= last)
        seen = history.scans[row].features
        new.extend(
            poses[k],
            motions[k],
            seen.segments,
            seen.corners,
            replace(landmark_ids, walls=np.where(strange, -1, landmark_ids.walls)),
        )
    new.graph.tie_keyframes(decision.old, last, relative, CARRYING_SIGMAS)
    new.solve()
    rows = new.landmarks.walls.rows
    joined = [(old, recent) for old, recent in decision.pairs if together(rows[old], rows[recent])]
    if len(joined) < LEAST_MERGED * len(decision.pairs):
        return None
    for old, recent in joined:
        if rows["merged_into"][old] == old and rows["merged_into"][recent] == recent:
            new.landmarks.absorb(old, recent)
    shift = float(np.hypot(*(new.keyframe_poses[last] - poses[last])[:2]))
    return Closed(new, replace(decision, status="accepted", merged=tuple(joined), shift=shift))

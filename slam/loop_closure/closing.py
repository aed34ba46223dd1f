"""Closing of a confirmed loop: correct the drift since the place was mapped, and merge walls seen in both passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.significance import SUPPORT_RATIO
from ..graph.factor_graph import CLOSING_UPDATES
from ..graph.factors import Factor, FactorKind
from ..mapping.mapper import Mapper
from ..mapping.wall_merging import find_overlaps
from .decision import LoopDecision, LoopMatch
from .look import SEARCH_INTERVAL
from .loop_status import LoopStatus
from .relative_uncertainty import MAX_SQUARED_DISTANCE
from .submap_search import REVISIT_GAP, SUBMAP_LENGTH

# Covariance (3, 3) of the temporary loop factor, which only moves the map into place, metres and radians.
# Origin: chosen, tighter than any drift; not measured.
LOOP_FACTOR_COVARIANCE = np.diag(np.array([0.01, 0.01, np.radians(0.2)]) ** 2)
# Number of submap matches that have a point in common, as looks follow each other at a part of a submap: their errors
# are not independent, so the covariance of each is multiplied by it. Origin: definition.
POINT_SHARING = SUBMAP_LENGTH / SEARCH_INTERVAL


def close_loop(mapper: Mapper, decision: LoopDecision) -> LoopDecision:
    """Move the recent keyframes to their poses by the decision's matches, then merge the walls that coincide.

    Observations of old walls by the recent keyframes, and their matches with old keyframes, would hold the map in
    place: they are removed first. If the decision joins parts of the map, there are none: the last part is moved as a
    whole instead, or the old one if the last is that of the first keyframe. Returns the decision with status ACCEPTED;
    or REJECTED if too many matches do not agree with the corrected map, and then the mapper must be discarded.
    """
    before, recent, temporary = mapper.pose, _is_recent(mapper, decision), moving_loops(decision)
    moved = np.zeros(0, dtype=np.int64)
    if decision.joins:
        moved = mapper.join_part(decision.old, decision.correction, temporary)
    else:
        _separate_passes(mapper, decision.since)
        mapper.graph.add_matches(temporary)
    closed = pull_together(mapper, decision, recent, temporary)
    if closed.status is not LoopStatus.ACCEPTED:
        return closed
    mapper.equalise_covariances(moved)  # the temporary loops would leave them too certain
    return replace(closed, shift=float(np.hypot(*(mapper.pose - before)[:2])))


def add_return(mapper: Mapper, match: LoopMatch) -> None:
    """Add a match of the last keyframe with a known place, which the estimate agrees with, to the graph.

    The keyframe's scan has been matched with this place before, but only by points on no known wall, and together with
    the keyframes just before it, so that drift along a corridor remains. A match that has points in common with the
    last one in the graph is left out: their errors are the same. Takes effect with the graph's next update.
    """
    last = mapper.graph.last_submap_match()
    if last is not None and match.travelled - mapper.travelled[last] < SUBMAP_LENGTH:
        return
    mapper.graph.add_submap_match(match.old, match.keyframe, match.relative, match.covariance)


def moving_loops(decision: LoopDecision) -> list[Factor]:
    """Return temporary factors that move keyframes to their poses by a decision's matches."""
    return [
        Factor(FactorKind.LOOP, match.old, match.keyframe, match.relative, LOOP_FACTOR_COVARIANCE)
        for match in decision.matches
    ]


def pull_together(
    mapper: Mapper, decision: LoopDecision, recent: NDArray[np.bool_], temporary: Sequence[Factor]
) -> LoopDecision:
    """Move keyframes to their poses by a decision's matches, then merge walls that coincide, if one is `recent` (w,).

    `temporary` are the `moving_loops`, which have been added to the graph. Nothing else may hold the keyframes in
    place. Returns the decision, accepted or rejected, as `close_loop` does.
    """
    graph = mapper.graph
    graph.update()
    graph.update_until_converged(CLOSING_UPDATES)
    mapper.read_back_all()
    agreeing = [match for match in decision.matches if _agrees(mapper, match)]
    if len(agreeing) * (SUPPORT_RATIO + 1.0) < len(decision.matches) * SUPPORT_RATIO:
        reason = "the matches do not fit the corrected map"
        return replace(decision, status=LoopStatus.REJECTED, reason=reason)
    merged = _merge_coinciding_walls(mapper, recent)
    graph.remove_factors(temporary)
    for match in agreeing:
        graph.add_loop(match.old, match.keyframe, match.relative, POINT_SHARING * match.covariance)
    graph.update()
    graph.update_until_converged(CLOSING_UPDATES)
    mapper.read_back_all()
    return replace(decision, status=LoopStatus.ACCEPTED, merged=tuple(merged))


def _separate_passes(mapper: Mapper, since: int) -> None:
    """Remove what ties the keyframes from `since` on to earlier passes.

    A wall that such a keyframe observes again after REVISIT_GAP was associated where the estimate had drifted to: it
    may be another wall. Walls that are observed all along the drive are kept.
    """
    travelled = np.asarray(mapper.travelled)
    observers: dict[int, list[int]] = {}
    for keyframe, wall in mapper.graph.wall_observations():
        observers.setdefault(wall, []).append(keyframe)
    again: dict[int, int] = {}
    for wall, keyframes in observers.items():
        seen = np.sort(keyframes)
        gaps = np.flatnonzero(np.diff(travelled[seen]) > REVISIT_GAP)
        if len(gaps) and seen[-1] >= since:
            again[wall] = max(since, int(seen[gaps[-1] + 1]))
    mapper.remove_wall_observations(again)
    mapper.graph.remove_matches(since, int(np.searchsorted(travelled, travelled[since] - REVISIT_GAP)) - 1)


def _agrees(mapper: Mapper, match: LoopMatch) -> bool:
    """Return True if the map agrees with a match."""
    poses = mapper.keyframe_poses
    error = se2.between(se2.between(poses[match.old], poses[match.keyframe]), match.relative)
    return bool(error @ np.linalg.solve(match.covariance, error) < MAX_SQUARED_DISTANCE)


def _is_recent(mapper: Mapper, decision: LoopDecision) -> NDArray[np.bool_]:
    """Return (n,) which walls are of the pass that a decision moves, or of the part of the map that it joins."""
    if decision.joins:
        return mapper.landmarks.connected()
    return np.asarray(mapper.landmarks.walls.rows["first_seen"] >= decision.since)


def _merge_coinciding_walls(mapper: Mapper, is_recent: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Merge walls of which one `is_recent` (n,) and the other not, if they coincide; return their ids (old, recent)."""
    walls = mapper.landmarks.walls.rows
    rows = np.flatnonzero(walls["in_graph"] & mapper.landmarks.active() & mapper.landmarks.connected())
    recent, merged = is_recent[rows], []
    for pair in find_overlaps(walls["frame"][rows], walls["low"][rows], walls["high"][rows]):
        one, other = int(rows[pair.first]), int(rows[pair.second])
        if recent[pair.first] == recent[pair.second] or not _are_separate(walls, one, other):
            continue
        old, new = (other, one) if recent[pair.first] else (one, other)
        mapper.merge_walls(old, new)
        merged.append((old, new))
    return merged


def _are_separate(walls: np.ndarray[Any, Any], one: int, other: int) -> bool:
    """Return True if neither of two walls has been merged into another one."""
    return bool(walls["merged_into"][one] == one and walls["merged_into"][other] == other)

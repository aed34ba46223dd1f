"""Closing of a confirmed loop: correct the drift since the place was mapped, and merge walls seen in both passes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from drivers import se2

from ..geometry.segments import Integers
from ..graph.factor_graph import CLOSING_UPDATES
from ..mapping.mapper import Mapper
from ..mapping.wall_merging import find_overlaps
from .agreement import MAX_SQUARED_DISTANCE, SEARCH_INTERVAL, SUBMAP_LENGTH, SUPPORT_RATIO
from .decision import LoopDecision, LoopMatch
from .loop_status import LoopStatus
from .recent_walls import REFERENCE_DISTANCE

# Metres, metres, radians: standard deviations of the temporary loop factor, which only moves the map into place.
# Origin: chosen, tighter than any drift; not measured.
LOOP_FACTOR_SIGMAS = np.array([0.01, 0.01, np.radians(0.2)])
# Least share of the matched walls that must coincide after the correction. Origin: chosen; not measured.
MIN_COINCIDING_SHARE = 0.5
# Metres by which a hypothesis may move a wall across itself that both passes observed; more means that the later pass
# observed another wall. Origin: chosen, the scatter of one wall between passes; not measured.
MAX_SHARED_WALL_SHIFT = 0.10
# Radians, likewise. Origin: chosen; not measured.
MAX_SHARED_WALL_TURN = np.radians(3.0)
# Metres between two walls that are merged, after the correction. Origin: chosen; not measured.
COINCIDENCE_OFFSET = 0.20
# Radians, likewise. Origin: chosen; not measured.
COINCIDENCE_HEADING = np.radians(6.0)

# Metres of driving without an observation after which a wall is seen again, not still.
# Origin: definition, two submaps: the recent one and that of an old place do not overlap.
REVISIT_GAP = 2.0 * SUBMAP_LENGTH
# Matches of submaps in which one point is used. Origin: definition.
POINT_SHARING = SUBMAP_LENGTH / SEARCH_INTERVAL


def close_loop(mapper: Mapper, decision: LoopDecision) -> LoopDecision:
    """Move the last keyframe to its pose by the decision, then merge each pair of walls.

    A loop factor moves the map and is removed once the walls are merged, because it rests on the same observations as
    they do. Returns the decision with status ACCEPTED; or REJECTED if too few walls coincide, and then the mapper must
    be discarded.
    """
    before, last = mapper.pose, mapper.keyframe_count - 1
    corrected = se2.compose(decision.hypothesis.motion, mapper.pose)
    relative = se2.between(mapper.graph.keyframe_pose(decision.old), corrected)
    misassociated, since = find_misassociated_walls(mapper, decision)
    mapper.remove_wall_observations(dict.fromkeys(misassociated.tolist(), since))
    loop_factors = mapper.graph.close_loop(decision.old, last, relative, LOOP_FACTOR_SIGMAS)
    mapper.read_back_all()
    rows = mapper.landmarks.walls.rows
    pairs = list(
        dict.fromkeys(
            (int(rows["merged_into"][old]), int(rows["merged_into"][recent])) for old, recent in decision.pairs
        )
    )
    coinciding = [(old, recent) for old, recent in pairs if old != recent and walls_coincide(rows[old], rows[recent])]
    if len(coinciding) < MIN_COINCIDING_SHARE * len(pairs):
        verdict = replace(decision.verdict, accepted=False, reason="the walls do not coincide after the correction")
        return replace(decision, status=LoopStatus.REJECTED, verdict=verdict)
    for old, recent in coinciding:
        if rows["merged_into"][old] == old and rows["merged_into"][recent] == recent:
            mapper.merge_walls(old, recent)
    mapper.graph.update()
    mapper.graph.update_until_converged(CLOSING_UPDATES)
    mapper.graph.remove_factors(loop_factors)
    mapper.read_back_all()
    shift = float(np.hypot(*(mapper.pose - before)[:2]))
    return replace(decision, status=LoopStatus.ACCEPTED, merged=tuple(coinciding), shift=shift)


def close_agreeing_loop(mapper: Mapper, decision: LoopDecision) -> LoopDecision:
    """Move the recent keyframes to their poses by the decision's matches, then merge the walls that coincide.

    Observations of old walls by the recent keyframes, and their matches with old keyframes, would hold the map in
    place: they are removed first. Returns the decision with status ACCEPTED; or REJECTED if too many matches do not
    agree with the corrected map, and then the mapper must be discarded.
    """
    before, graph = mapper.pose, mapper.graph
    _separate_passes(mapper, decision.since)
    for match in decision.matches:
        graph.add_loop(match.old, match.keyframe, match.relative, LOOP_FACTOR_SIGMAS)
    numbers = graph.update()
    graph.update_until_converged(CLOSING_UPDATES)
    mapper.read_back_all()
    agreeing = [match for match in decision.matches if _agrees(mapper, match)]
    if len(agreeing) * (SUPPORT_RATIO + 1.0) < len(decision.matches) * SUPPORT_RATIO:
        verdict = replace(decision.verdict, accepted=False, reason="the matches do not fit the corrected map")
        return replace(decision, status=LoopStatus.REJECTED, verdict=verdict)
    merged = _merge_coinciding_walls(mapper, decision.since)
    graph.remove_factors(numbers)
    for match in agreeing:
        graph.add_loop_match(match.old, match.keyframe, match.relative, POINT_SHARING * match.covariance)
    graph.update()
    graph.update_until_converged(CLOSING_UPDATES)
    mapper.read_back_all()
    shift = float(np.hypot(*(mapper.pose - before)[:2]))
    return replace(decision, status=LoopStatus.ACCEPTED, merged=tuple(merged), shift=shift)


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
    mapper.graph.remove_scan_matches(since, int(np.searchsorted(travelled, travelled[since] - REVISIT_GAP)) - 1)


def _agrees(mapper: Mapper, match: LoopMatch) -> bool:
    """True if the map agrees with a match."""
    poses = mapper.keyframe_poses
    error = se2.between(se2.between(poses[match.old], poses[match.keyframe]), match.relative)
    return bool(error @ np.linalg.solve(match.covariance, error) < MAX_SQUARED_DISTANCE)


def _merge_coinciding_walls(mapper: Mapper, since: int) -> list[tuple[int, int]]:
    """Merge walls first seen before and since a keyframe that coincide; return their ids (old, recent)."""
    walls = mapper.landmarks.walls.rows
    rows = np.flatnonzero(walls["in_graph"] & mapper.landmarks.active())
    recent, merged = walls["first_seen"][rows] >= since, []
    for pair in find_overlaps(walls["frame"][rows], walls["low"][rows], walls["high"][rows]):
        one, other = int(rows[pair.first]), int(rows[pair.second])
        if recent[pair.first] == recent[pair.second] or not _are_separate(walls, one, other):
            continue
        if walls_coincide(walls[one], walls[other]):
            old, new = (other, one) if recent[pair.first] else (one, other)
            mapper.merge_walls(old, new)
            merged.append((old, new))
    return merged


def _are_separate(walls: np.ndarray[Any, Any], one: int, other: int) -> bool:
    """True if neither of two walls has been merged into another one."""
    return bool(walls["merged_into"][one] == one and walls["merged_into"][other] == other)


def walls_coincide(wall: np.void, other: np.void) -> bool:
    """True if two walls, rows of the landmark table, lie on one line; compared at the middle of the second."""
    relative = se2.between(wall["frame"], other["frame"])
    offset = relative[1] + 0.5 * (other["low"] + other["high"]) * np.sin(relative[2])
    return bool(abs(offset) < COINCIDENCE_OFFSET and abs(relative[2]) < COINCIDENCE_HEADING)


def find_misassociated_walls(mapper: Mapper, decision: LoopDecision) -> tuple[Integers, int]:
    """Find the old walls that features of the recent pass were wrongly associated with because of drift.

    Their observations would hold the map in place. A wall that was observed both before and during the recent pass must
    not move across itself with this pass; if it does, the pass observed another wall.

    Returns the wall ids (n,), and the keyframe at which the recent pass began.
    """
    walls = mapper.landmarks.walls.rows
    travelled = np.array(mapper.travelled)
    first_seen = [int(walls["first_seen"][recent]) for _, recent in decision.pairs]
    since = min(
        (keyframe for keyframe in first_seen if travelled[-1] - travelled[keyframe] < REFERENCE_DISTANCE),
        default=mapper.keyframe_count,
    )
    both = np.flatnonzero(walls["in_graph"] & (walls["first_seen"] < since) & (walls["last_seen"] >= since))
    moved = se2.between(walls["frame"][both], se2.compose(decision.hypothesis.motion, walls["frame"][both]))
    moved = moved.reshape(-1, 3)
    return both[(np.abs(moved[:, 1]) > MAX_SHARED_WALL_SHIFT) | (np.abs(moved[:, 2]) > MAX_SHARED_WALL_TURN)], since

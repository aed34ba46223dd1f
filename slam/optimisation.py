"""Optimise a stored session offline: refine its map and trajectory, and check its loop closures again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .checks import find_suspects
from .checks.adapter import drive_of
from .errors import MapError
from .estimation.map_view import final_result
from .estimation.refinement import RefinementResult, ScanHistory, refine
from .events import Finished, Sink
from .io.sessions import StoredSession
from .localisation.tracker import PoseFix
from .loop_closure.loop_status import LoopStatus
from .loop_closure.recent_walls import REFERENCE_DISTANCE
from .mapping.mapper import Mapper
from .mapping.odometry_segments import OdometrySegments
from .publisher import Publisher
from .run_statistics import loop_row

# Keyframes before a loop closure that are checked for walls in common with the older part of the map.
CHECKED_KEYFRAMES = 10
# Number of keyframes with the largest shifts in the summary.
LISTED_SHIFTS = 5


@dataclass(frozen=True, slots=True, eq=False)
class OptimisedSession:
    """Result of optimising a session.

    finished  the final map and trajectory
    session   the session to continue from
    summary   what changed, for summary.json
    """

    finished: Finished
    session: StoredSession
    summary: dict[str, Any]


def optimise(session: StoredSession, sinks: Sequence[Sink] = ()) -> OptimisedSession:
    """Optimise a session; the input must not be used afterwards.

    Publishes the map before, every keyframe at its new pose, and the map after. Raises MapError if the session has
    fewer than two keyframes, or the estimate is undetermined.
    """
    slam_state, publisher = session.slam_state, Publisher(sinks)
    if slam_state.mapper.keyframe_count < 2:
        raise MapError("nothing to optimise: the session has fewer than two keyframes")
    slam_state.mapper.converge()
    before, history = slam_state.mapper, session.scan_history()
    publisher.publish_map(float(history.stamps[0]), before, index=0)
    refined = refine(before, history, slam_state.odometry_model)
    keyframes = {k: session.scans[row] for k, row in enumerate(history.keyframes.tolist())}
    refined.mapper.recompute_pose_covariances()
    last = session.scans[-1]
    slam_state.replace_map(refined.mapper, refined.trajectory, PoseFix(refined.poses[-1], last.odometry), keyframes)
    decisions = _update_decisions(session.loop_decisions, refined, history)
    summary = refined.summary | _changes(before, refined.mapper, session.loop_decisions, decisions)
    publisher.publish_keyframes(refined.mapper, keyframes, session.sigma_range)
    publisher.publish_map(last.stamp, refined.mapper)
    segments = OdometrySegments(session.odometry, session.starts)
    poses = slam_state.mapper.keyframe_poses
    placed = slam_state.trajectory.at_scans(poses)
    suspects = find_suspects(drive_of(session.scans, session.starts, placed, slam_state.odometry_model, session.config))
    publisher.publish_suspects(suspects, slam_state.keyframe_stamps)
    result = final_result(
        slam_state,
        segments.trajectory(slam_state.trajectory, poses),
        {"refinement": summary, "suspects": [suspect.row() for suspect in suspects]},
    )
    publisher.publish(result)
    return OptimisedSession(result, replace(session, loop_decisions=decisions), summary)


def _changes(
    before: Mapper, after: Mapper, old: Sequence[Mapping[str, Any]], new: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Compare the maps and loop decisions before and after, for the summary."""
    moved = np.hypot(*(after.keyframe_poses - before.keyframe_poses)[:, :2].T)
    farthest = np.argsort(-moved, kind="stable")[:LISTED_SHIFTS]
    removed = sum(a["status"] == LoopStatus.ACCEPTED != b["status"] for a, b in zip(old, new, strict=False))
    return {
        "factors_before": before.graph.factor_count,
        "factors_after": after.graph.factor_count,
        "closures_removed": removed,
        "median_shift": round(float(np.median(moved)), 4),
        "largest_shifts": [{"keyframe": int(k), "metres": round(float(moved[k]), 4)} for k in farthest],
    }


def _update_decisions(
    rows: Sequence[Mapping[str, Any]], refined: RefinementResult, history: ScanHistory
) -> list[dict[str, Any]]:
    """Return the updated loop decisions: closures that do not hold any more are marked, missed loops are appended."""
    decisions = [dict(row) for row in rows]
    for row in decisions:
        if row["status"] == LoopStatus.ACCEPTED and not _holds(refined.mapper, int(row["keyframe"])):
            row |= {"status": "removed", "reason": "both passes have no wall in common any more"}
    stamps = history.stamps[history.keyframes]
    return decisions + [loop_row(float(stamps[decision.keyframe]), decision) for decision in refined.loop_decisions]


def _holds(mapper: Mapper, keyframe: int) -> bool:
    """Return True if the keyframes up to `keyframe` observed a wall that was first observed on an older pass."""
    travelled = np.array(mapper.travelled)
    walls = [mapper.landmark_ids[k].walls for k in range(max(0, keyframe - CHECKED_KEYFRAMES), keyframe + 1)]
    observed = np.unique(np.concatenate(walls))
    observed = mapper.landmarks.walls.rows["merged_into"][observed[observed >= 0]]
    first = mapper.landmarks.walls.rows["first_seen"][observed[observed >= 0]]
    return bool((travelled[keyframe] - travelled[first] > REFERENCE_DISTANCE).any())

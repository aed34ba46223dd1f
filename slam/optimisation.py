"""A whole session looked at again, with time to spare: associated anew and solved in batch until it settles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .errors import MapError
from .estimation.map_view import final_result
from .estimation.refinement import Refined, ScanHistory, refine
from .events import Finished, Sink
from .io.sessions import StoredSession
from .localisation.tracker import PoseFix
from .loop_closure.loop_status import LoopStatus
from .loop_closure.recent_walls import REFERENCE_DISTANCE
from .mapping.mapper import Mapper
from .mapping.odometry_segments import OdometrySegments
from .publisher import Publisher
from .run_statistics import loop_row

PASS = 10  # keyframes before a closure that count as the pass that it joined to an older one
SHOWN_SHIFTS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Optimised:
    """The map and path that came of it, and the session to go on from; `summary` says what changed."""

    finished: Finished
    session: StoredSession
    summary: dict[str, Any]


def optimise(session: StoredSession, sinks: Sequence[Sink] = ()) -> Optimised:
    """Optimise a session, which is not to be used any more.

    Listeners are told of the map before, of every keyframe where it is now, and of the map after. Raises MapError where
    there is nothing to optimise, or the estimate is undetermined.
    """
    slam_state, reporter = session.slam_state, Publisher(sinks)
    if slam_state.mapper.keyframe_count < 2:
        raise MapError("there are fewer than two keyframes, so there is nothing to optimise")
    slam_state.mapper.converge()
    before, drive = slam_state.mapper, session.scan_history()
    reporter.publish_map(float(drive.stamps[0]), before, index=0)
    refined = refine(before, drive, slam_state.odometry_model)
    keyframes = {k: session.scans[row] for k, row in enumerate(drive.keyframes.tolist())}
    refined.mapper.recompute_pose_covariances()
    last = session.scans[-1]
    slam_state.replace_map(refined.mapper, refined.path, PoseFix(refined.poses[-1], last.odometry), keyframes)
    closures = _closures(session.loop_decisions, refined, drive)
    summary = refined.summary | _changes(before, refined.mapper, session.loop_decisions, closures)
    reporter.publish_keyframes(refined.mapper, keyframes, session.sigma_range)
    reporter.publish_map(last.stamp, refined.mapper)
    drives = OdometrySegments(session.odometry, session.starts)
    result = final_result(
        slam_state, drives.trajectory(slam_state.trajectory, slam_state.mapper.keyframe_poses), {"refinement": summary}
    )
    reporter.publish(result)
    return Optimised(result, replace(session, loop_decisions=closures), summary)


def _changes(
    before: Mapper, after: Mapper, old: Sequence[Mapping[str, Any]], new: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """What the summary tells besides."""
    moved = np.hypot(*(after.keyframe_poses - before.keyframe_poses)[:, :2].T)
    farthest = np.argsort(-moved, kind="stable")[:SHOWN_SHIFTS]
    removed = sum(a["status"] == LoopStatus.ACCEPTED != b["status"] for a, b in zip(old, new, strict=False))
    return {
        "factors_before": before.graph.factor_count,
        "factors_after": after.graph.factor_count,
        "closures_removed": removed,
        "median_shift": round(float(np.median(moved)), 4),
        "largest_shifts": [{"keyframe": int(k), "metres": round(float(moved[k]), 4)} for k in farthest],
    }


def _closures(rows: Sequence[Mapping[str, Any]], refined: Refined, drive: ScanHistory) -> list[dict[str, Any]]:
    """The decisions on closures as they stand now: what held and holds no more is removed, what was found is added."""
    told = [dict(row) for row in rows]
    for row in told:
        if row["status"] == LoopStatus.ACCEPTED and not _holds(refined.mapper, int(row["keyframe"])):
            row |= {"status": "removed", "reason": "the two passes see no wall in common any more"}
    stamps = drive.stamps[drive.keyframes]
    return told + [loop_row(float(stamps[decision.keyframe]), decision) for decision in refined.closures]


def _holds(mapper: Mapper, keyframe: int) -> bool:
    """Whether what was seen on the way to a keyframe is on any wall that an older pass saw."""
    travelled = np.array(mapper.travelled)
    walls = [mapper.landmark_ids[k].walls for k in range(max(0, keyframe - PASS), keyframe + 1)]
    seen = np.unique(np.concatenate(walls))
    seen = mapper.landmarks.walls.rows["merged_into"][seen[seen >= 0]]
    first = mapper.landmarks.walls.rows["first_seen"][seen[seen >= 0]]
    return bool((travelled[keyframe] - travelled[first] > REFERENCE_DISTANCE).any())

"""Rounds of refinement until nothing changes any more, then the path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry.segments import Floats
from ...loop_closure.closer import LoopDecision
from ...mapping.mapper import Mapper
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...odometry.error_model import OdometryModel
from .iteration import Round, refine_once
from .missed_closures import Closed, carried_over, missed_closure
from .scan_history import ScanHistory
from .smoothing import refine_path

MOST_ROUNDS = 3  # on recordings a fourth no longer makes the path better, though single associations still change
MOST_CLOSURES = 5  # each is followed by all rounds again
AT_REST = 0.001  # metres that a keyframe may still move in the last round


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The refined map, the poses (n, 3) of all sightings on it, alone and as a path, the closures that had been missed,
    and what was done."""

    mapper: Mapper
    poses: Floats
    path: TrajectoryBuilder
    closures: list[LoopDecision]
    summary: dict[str, object]


def match_trajectory(mapper: Mapper, history: ScanHistory, model: OdometryModel) -> TrajectoryBuilder:
    """The path of a drive with every sighting laid over the map as it is."""
    poses = mapper.keyframe_poses
    everywhere, _ = refine_path(mapper, history, model, poses, np.zeros(len(history), dtype=bool))
    return history.path(poses, everywhere)


def refine(mapper: Mapper, history: ScanHistory, model: OdometryModel) -> Refined:
    """Refine the map of a drive. The mapper is settled; it is left as it is."""
    first, cost = mapper.graph.keyframe_poses(mapper.keyframe_count), mapper.graph.chi2()
    poses, odometry_wrong = first, np.zeros(len(history), dtype=bool)
    closures: list[LoopDecision] = []
    done = changed = merged = 0
    left, shift = MOST_ROUNDS, np.inf
    while left and shift > AT_REST:
        result = refine_once(mapper, history, model, poses, odometry_wrong)
        shift = float(np.max(np.hypot(*(result.poses - poses)[:, :2].T)))
        mapper, poses, odometry_wrong = result.mapper, result.poses, result.odometry_wrong
        done, changed, merged = done + 1, changed + result.changed, merged + result.merged
        closed = (
            _close_what_was_missed(result, history) if left == MOST_ROUNDS and len(closures) < MOST_CLOSURES else None
        )
        left -= 1
        if closed is not None:
            mapper, poses, shift = closed.mapper, closed.mapper.keyframe_poses, np.inf
            closures, left = [*closures, closed.decision], MOST_ROUNDS
    everywhere, overlap_ratio = refine_path(mapper, history, model, poses, odometry_wrong)
    moved = np.hypot(*(poses - first)[:, :2].T)
    summary: dict[str, object] = {
        "rounds": done,
        "cost_before": round(cost, 3),
        "cost_after": round(mapper.graph.chi2(), 3),
        "associations_changed": changed,
        "walls_merged": merged,
        "closures_added": len(closures),
        "scans_found_astray": int(odometry_wrong.sum()),
        "largest_shift": round(float(np.max(moved, initial=0.0)), 4),
        "last_shift": round(shift, 5),
        "overlap_ratio_median": round(float(np.nanmedian(overlap_ratio)), 3),
    }
    return Refined(mapper, everywhere, history.path(poses, everywhere), closures, summary)


def _close_what_was_missed(result: Round, history: ScanHistory) -> Closed | None:
    """The map of a round with the first loop closed that was missed so far; None where there is none."""
    missed = missed_closure(result.mapper, history)
    return None if missed is None else carried_over(result.mapper, history, result.motions, missed)

"""Refine a session: iterate until the keyframes converge, close missed loops, then match all scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry.segments import Floats
from ...loop_closure.decision import LoopDecision
from ...mapping.mapper import Mapper
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...odometry.error_model import OdometryModel
from .iteration import IterationResult, refine_once
from .missed_closures import ClosedLoop, close_missed_loop, find_missed_loop
from .scan_history import ScanHistory
from .smoothing import smooth_trajectory

# Maximum number of iterations after the last loop closure. Origin: measured, on recordings a fourth still changes
# single associations but does not improve the trajectory.
MAX_ITERATIONS = 3
# Maximum number of missed loops closed; each is followed by all iterations again.
# Origin: chosen, bounds the time; not measured.
MAX_MISSED_LOOPS = 5
# Metres; the iteration has converged if no keyframe moves farther. Origin: chosen; not measured.
CONVERGED_SHIFT = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class RefinementResult:
    """Result of refining a session.

    mapper          the refined map
    poses           (n, 3) of all scans
    trajectory      the same relative to keyframes
    loop_decisions  on loops that had been missed and are closed now
    summary         what was done, for summary.json
    """

    mapper: Mapper
    poses: Floats
    trajectory: TrajectoryBuilder
    loop_decisions: list[LoopDecision]
    summary: dict[str, object]


def match_trajectory(mapper: Mapper, history: ScanHistory, model: OdometryModel) -> TrajectoryBuilder:
    """Match every scan to the map and return the smoothed trajectory; the map does not change."""
    poses = mapper.keyframe_poses
    scan_poses, _ = smooth_trajectory(mapper, history, model, poses, np.zeros(len(history), dtype=bool))
    return history.trajectory(poses, scan_poses)


def refine(mapper: Mapper, history: ScanHistory, model: OdometryModel) -> RefinementResult:
    """Refine the map of a session. The mapper has converged; it is not modified."""
    initial, cost = mapper.graph.keyframe_poses(mapper.keyframe_count), mapper.graph.chi2()
    poses, odometry_wrong = initial, np.zeros(len(history), dtype=bool)
    loop_decisions: list[LoopDecision] = []
    iterations = changed = merged = 0
    remaining, shift = MAX_ITERATIONS, np.inf
    while remaining and shift > CONVERGED_SHIFT:
        result = refine_once(mapper, history, model, poses, odometry_wrong)
        shift = float(np.max(np.hypot(*(result.poses - poses)[:, :2].T)))
        mapper, poses, odometry_wrong = result.mapper, result.poses, result.odometry_wrong
        iterations, changed, merged = iterations + 1, changed + result.changed, merged + result.merged
        closed = None
        if remaining == MAX_ITERATIONS and len(loop_decisions) < MAX_MISSED_LOOPS:
            closed = _close_first_missed_loop(result, history)
        remaining -= 1
        if closed is not None:
            mapper, poses, shift = closed.mapper, closed.mapper.keyframe_poses, np.inf
            loop_decisions, remaining = [*loop_decisions, closed.decision], MAX_ITERATIONS
    scan_poses, overlap_ratio = smooth_trajectory(mapper, history, model, poses, odometry_wrong)
    moved = np.hypot(*(poses - initial)[:, :2].T)
    summary: dict[str, object] = {
        "iterations": iterations,
        "cost_before": round(cost, 3),
        "cost_after": round(mapper.graph.chi2(), 3),
        "associations_changed": changed,
        "walls_merged": merged,
        "closures_added": len(loop_decisions),
        "scans_with_wrong_odometry": int(odometry_wrong.sum()),
        "largest_shift": round(float(np.max(moved, initial=0.0)), 4),
        "last_shift": round(shift, 5),
        "overlap_ratio_median": round(float(np.nanmedian(overlap_ratio)), 3),
    }
    return RefinementResult(mapper, scan_poses, history.trajectory(poses, scan_poses), loop_decisions, summary)


def _close_first_missed_loop(result: IterationResult, history: ScanHistory) -> ClosedLoop | None:
    """Close the first missed loop on the map of an iteration; return None if there is none."""
    missed = find_missed_loop(result.mapper, history)
    return None if missed is None else close_missed_loop(result.mapper, history, result.motions, missed)

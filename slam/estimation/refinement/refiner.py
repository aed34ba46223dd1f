"""Refine a session: iterate until the keyframes converge, then match all scans."""

from __future__ import annotations

import numpy as np

from drivers.immutable import immutable

from ...geometry.segments import Floats
from ...localisation.path_distances import PathDistances
from ...mapping.convergence import settle_range_bias
from ...mapping.mapper import Mapper
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...odometry.error_model import OdometryModel
from .iteration import refine_once
from .scan_history import ScanHistory
from .smoothing import smooth_trajectory

# Maximum number of iterations. Origin: measured, on recordings a fourth still changes
# single associations but does not improve the trajectory.
MAX_ITERATIONS = 3
# Metres; the iteration has converged if no keyframe moves farther. Origin: numerical.
CONVERGED_SHIFT = 0.001


@immutable
class RefinementResult:
    """Result of refining a session.

    mapper          the refined map
    poses           (n, 3) of all scans
    trajectory      the same relative to keyframes
    summary         what was done, for summary.json
    """

    mapper: Mapper
    poses: Floats
    trajectory: TrajectoryBuilder
    summary: dict[str, object]


def match_trajectory(
    mapper: Mapper, history: ScanHistory, model: OdometryModel, path_distances: PathDistances
) -> TrajectoryBuilder:
    """Match every scan to the map and return the smoothed trajectory; the map does not change.

    `path_distances` are those between the keyframes.
    """
    poses = mapper.keyframe_poses
    scan_poses, _ = smooth_trajectory(mapper, history, model, poses, path_distances, ~history.measured)
    return history.trajectory(poses, scan_poses)


def refine(
    mapper: Mapper, history: ScanHistory, model: OdometryModel, path_distances: PathDistances
) -> RefinementResult:
    """Refine the map of a session. The mapper has converged; it is not modified.

    `path_distances` are those between the keyframes.
    """
    initial, cost = mapper.graph.keyframe_poses(mapper.keyframe_count), mapper.graph.chi2()
    matches = mapper.graph.matches()
    poses, odometry_wrong = initial, ~history.measured
    iterations = changed = merged = 0
    shift = np.inf
    while iterations < MAX_ITERATIONS and shift > CONVERGED_SHIFT:
        result = refine_once(mapper, history, model, matches, poses, path_distances, odometry_wrong)
        shift = float(np.max(np.hypot(*(result.poses - poses)[:, :2].T)))
        mapper, poses, odometry_wrong = result.mapper, result.poses, result.odometry_wrong
        iterations, changed, merged = iterations + 1, changed + result.changed, merged + result.merged
    settle_range_bias(mapper, correlate=True)
    poses = mapper.keyframe_poses
    scan_poses, overlap_ratio = smooth_trajectory(mapper, history, model, poses, path_distances, odometry_wrong)
    moved = np.hypot(*(poses - initial)[:, :2].T)
    summary: dict[str, object] = {
        "iterations": iterations,
        "cost_before": round(cost, 3),
        "cost_after": round(mapper.graph.chi2(), 3),
        "associations_changed": changed,
        "walls_merged": merged,
        "scans_with_wrong_odometry": int(odometry_wrong.sum()),
        "largest_shift": round(float(np.max(moved, initial=0.0)), 4),
        "last_shift": round(shift, 5),
        "overlap_ratio_median": round(float(np.nanmedian(overlap_ratio)), 3),
    }
    return RefinementResult(mapper, scan_poses, history.trajectory(poses, scan_poses), summary)

"""Optimise a stored session offline: refine its map and trajectory, and check its loop closures again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.immutable import immutable

from ..errors import MapError
from ..estimation.refinement import refine
from ..estimation.wall_bends import settle_wall_bends
from ..events import Finished, Notice, Sink
from ..geometry.segments import Floats
from ..io.sessions import StoredSession
from ..localisation.tracking import PoseFix
from ..mapping.convergence import converge
from ..mapping.manual_changes import fragile_changes
from ..mapping.mapper import Mapper
from ..mapping.odometry_segments import OdometrySegments
from ..mapping.plan_map import VIEWS_END
from ..reporting.publisher import Publisher
from ..reporting.results import publish_results

# Number of keyframes with the largest shifts in the summary.
LISTED_SHIFTS = 5


@immutable
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
    fewer than two keyframes, manual corrections that would be lost, or if the estimate is undetermined.
    """
    slam_state, publisher = session.slam_state, Publisher(sinks)
    if slam_state.mapper.keyframe_count < 2:
        raise MapError("nothing to optimise: the session has fewer than two keyframes")
    if changes := fragile_changes(slam_state.mapper):
        raise MapError(f"has {changes}, which a refinement would drop; refine before correcting")
    converge(slam_state.mapper)
    before, history = slam_state.mapper, session.scan_history()
    publisher.publish_map(float(history.stamps[0]), before, index=0)
    refined = refine(
        before, history, slam_state.odometry_model, slam_state.local_field.path_distances(before.travelled)
    )
    keyframes = history.keyframe_scans
    refined.mapper.recompute_pose_covariances()
    last = session.scans[-1]
    slam_state.replace_map(refined.mapper, refined.trajectory, PoseFix(refined.poses[-1], last.reading), keyframes)
    summary = refined.summary | _changes(before, refined.mapper)
    publisher.publish_keyframes(refined.mapper, keyframes, session.noise.sigma_range)
    publisher.publish_map(last.stamp, refined.mapper)
    moved = _shifts(before, refined.mapper)
    text = f"refined: keyframes moved by {np.median(moved):.3f} m (median), {moved.max():.3f} m at most"
    publisher.publish(Notice(last.stamp, text, "INFO"))
    result = summarise_session(session, {"refinement": summary}, publisher)
    return OptimisedSession(result, session, summary)


def summarise_session(session: StoredSession, summary: dict[str, Any], publisher: Publisher) -> Finished:
    """Check a session whose map is settled; publish and return its map and trajectory, with `summary` extended."""
    state, segments = session.slam_state, OdometrySegments(session.odometry, session.starts)
    history = session.scan_history()
    summary = summary | {"wall_bends": settle_wall_bends(state.mapper, history)}
    stamps, poses = segments.trajectory(state.trajectory, state.mapper.keyframe_poses)
    path = stamps[stamps > VIEWS_END], poses[stamps > VIEWS_END]
    return publish_results(state, session.scans, segments, path, history.sweep_covariances, summary, publisher)


def _changes(before: Mapper, after: Mapper) -> dict[str, Any]:
    """Compare the maps before and after, for the summary."""
    moved = _shifts(before, after)
    farthest = np.argsort(-moved, kind="stable")[:LISTED_SHIFTS]
    return {
        "factors_before": before.graph.factor_count,
        "factors_after": after.graph.factor_count,
        "median_shift": round(float(np.median(moved)), 4),
        "largest_shifts": [{"keyframe": int(k), "metres": round(float(moved[k]), 4)} for k in farthest],
    }


def _shifts(before: Mapper, after: Mapper) -> Floats:
    """Return the metres (k,) by which the keyframes have moved."""
    return np.asarray(np.hypot(*(after.keyframe_poses - before.keyframe_poses)[:, :2].T))

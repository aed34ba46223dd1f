"""Steps at the end of a run: leaving out an unknown session, settling the plan, refining or matching, publishing."""

from __future__ import annotations

import numpy as np

from .config import Config
from .errors import MapError
from .estimation.estimator import Estimator
from .estimation.journal import Journal
from .estimation.refinement import ScanHistory, match_trajectory, refine
from .estimation.slam_state import SlamState
from .estimation.wall_bends import settle_wall_bends
from .events import Finished, Notice
from .localisation.tracking import PoseFix
from .memory import return_freed_memory
from .reporting.delay_warning import find_scan_delay
from .reporting.publisher import Publisher
from .reporting.results import publish_results
from .reporting.run_statistics import RunStatistics


def is_unknown_place(estimator: Estimator, journal: Journal, *, frozen: bool, anywhere: bool) -> bool:
    """Return True if nothing of a run is in a place that is known to be in the map of the session that it continues.

    If its odometry goes on from that of the session, what is mapped is kept beside that map.

    frozen    true if that map is kept unchanged
    anywhere  true if the run began at an unknown pose in it
    """
    state, parts = estimator.result, estimator.state.mapper.landmarks.parts
    if frozen:
        return anywhere and not journal.any_tracked(state.trajectory)
    if not journal.in_new_odometry_segment:
        return False
    keyframes = np.flatnonzero(np.array(state.keyframe_stamps) > journal.stamp_before)
    if not len(keyframes):  # placed in the map, and only in familiar places since
        return not journal.any_tracked(state.trajectory)
    return not parts.connected(keyframes, 0).any()


def map_alone(config: Config, journal: Journal, statistics: RunStatistics, publisher: Publisher) -> Estimator:
    """Drop the earlier session from the journal, map the run without it, and return its estimator."""
    journal.drop_earlier_session()
    estimator = Estimator(SlamState(config))
    for scan in journal.scans:
        result = estimator.process(scan)
        for decision in (result.update.loop if result.update else None, result.retracted):
            if decision is not None:
                statistics.add_loop(scan.stamp, decision)
    stamp = journal.scans[-1].stamp
    text = "never relocalised in the map of the session: that map is left out of the results"
    publisher.publish(Notice(stamp, text))
    publisher.publish_map(stamp, estimator.result.mapper)
    return estimator


def settle_plan(state: SlamState, journal: Journal, publisher: Publisher) -> None:
    """Test the walls of the finished map against the plan; state it if the map was never recognised in that."""
    if state.plan is None:
        return
    stamp, before = journal.scans[-1].stamp, state.plan.recognised
    if not state.plan.settle(state.mapper, state.local_field):
        text = "never recognised in the plan: the map is in a frame of its own, and the plan is left out"
        publisher.publish(Notice(stamp, text))
    elif not before:
        publisher.publish(Notice(stamp, "the map is recognised in the plan", "INFO"))


def settle_trajectory(state: SlamState, journal: Journal, publisher: Publisher, *, refined: bool) -> dict[str, object]:
    """Match all scans to the final map, and estimate the bends of its walls and the delay of the scans.

    The map is `refined` before if wanted. Returns the summary's part.
    """
    history = journal.history(state)
    summary = _refine_or_match(state, journal, history, publisher, refined=refined)
    return_freed_memory()  # of the matches, else what is written would add to it
    bends, delay = settle_wall_bends(state.mapper, history), find_scan_delay(state, journal)
    return summary | {"wall_bends": bends, "scan_delay": None if delay is None else delay.row()}


def _refine_or_match(
    state: SlamState, journal: Journal, history: ScanHistory, publisher: Publisher, *, refined: bool
) -> dict[str, object]:
    """Match all scans to the final map, which is `refined` before if wanted; return the summary's part.

    `history` is that of the journal.
    """
    stamp = journal.scans[-1].stamp
    if state.mapper.keyframe_count < 2:
        return {}
    path_distances = state.local_field.path_distances(state.mapper.travelled)
    try:
        if not refined:
            known = journal.without_dispensable_features(history)  # the result must not depend on what is kept
            state.trajectory = match_trajectory(state.mapper, known, state.odometry_model, path_distances)
            return {}
        result = refine(state.mapper, history, state.odometry_model, path_distances)
    except MapError as error:
        publisher.publish(Notice(stamp, f"the scans are not matched to the final map: {error}"))
        return {}
    result.mapper.recompute_pose_covariances()
    if state.plan is not None and state.plan.recognised:
        state.plan.settle(result.mapper, state.local_field)
    fix = PoseFix(result.poses[-1], journal.scans[-1].reading)
    state.replace_map(result.mapper, result.trajectory, fix, history.keyframe_scans)
    publisher.publish_map(stamp, state.mapper)
    return {"refinement": result.summary}


def publish_run(
    state: SlamState, journal: Journal, publisher: Publisher, summary: dict[str, object], *, after: float
) -> Finished:
    """Check the finished run against itself, publish its results, and return them.

    after  stamp (seconds) after which poses belong to the results

    Raises MapError if none does.
    """
    stamps, poses = journal.segments.trajectory(state.trajectory, state.mapper.keyframe_poses)
    stamps, poses = stamps[stamps > after], poses[stamps > after]
    if not len(stamps):
        raise MapError("no measurement is later than those of the session whose map is used")
    own = stamps > journal.resumed_at
    publisher.publish_unseen(journal.scans.stamps[journal.first_row :], stamps[own], poses[own])
    sweep_covariances = journal.history(state).sweep_covariances
    path = stamps, poses
    return publish_results(state, journal.scans, journal.segments, path, sweep_covariances, summary, publisher)

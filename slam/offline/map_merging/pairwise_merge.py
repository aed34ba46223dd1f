"""Merge two sessions: all keyframes of both in one factor graph, connected where submaps were recognised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from drivers import se2

from ...errors import MapError
from ...estimation.refinement import build_scan_history
from ...estimation.refinement.iteration import motion_to_keyframe
from ...estimation.refinement.scan_history import ScanHistory
from ...estimation.slam_state import SlamState
from ...estimation.tracking_checkpoint import TrackingCheckpoint
from ...geometry.nearest_pose import relative_to_nearest
from ...geometry.segments import Floats
from ...io.sessions import StoredSession
from ...localisation.local_field import LocalFieldState
from ...localisation.path_distances import MAX_PATH
from ...loop_closure.closing import LOOP_FACTOR_COVARIANCE
from ...loop_closure.loop_hypothesis import LoopAgreementState
from ...mapping.convergence import converge
from ...mapping.mapper import Mapper
from ...mapping.wall_merging import find_overlaps
from ...odometry.error_model import OdometryModel
from ...recognition.location import PlacedSubmap
from .transfer import (
    IndexOffsets,
    clock_shift,
    merge_landmark_ids,
    merge_landmarks,
    merge_matches,
    merge_trajectories,
    shift_clock,
)


def merge_pair(first: StoredSession, second: StoredSession, members: Sequence[PlacedSubmap]) -> StoredSession:
    """Return the session with the contents of both, in the map frame of the first.

    `members` are submaps of the second that were placed in the first's map. They are loop closures, along which the
    second map is deformed onto the first; walls that coincide are merged then. Other walls that both observed are
    left to refinement. The second's clock is shifted if it does not start later than the first ends. Raises MapError if
    too few of the matched walls coincide.
    """
    offsets, shift = IndexOffsets.after(first), clock_shift(second, first.latest)
    state, other = first.slam_state, second.slam_state
    second = shift_clock(second, shift)
    model = OdometryModel(first.config.odometry)
    samples = np.concatenate([state.odometry_model.samples, other.odometry_model.samples])
    model.add_samples(samples)
    trajectory = merge_trajectories(state.trajectory, other.trajectory, offsets.keyframes, shift)
    stamps = [*state.keyframe_stamps, *(stamp + shift for stamp in other.keyframe_stamps)]
    scans, odometry = [*first.scans, *second.scans], [*first.odometry, *second.odometry]
    kidnapped = [*state.kidnapped_keyframes, *(k + offsets.keyframes for k in other.kidnapped_keyframes)]
    starts = [*first.starts, *(row + offsets.scans for row in second.starts)]
    history = build_scan_history(scans, trajectory, stamps, odometry, kidnapped, starts)
    mapper = _merge_maps(state.mapper, other.mapper, history, model, members)
    decisions, candidates = _merge_loop_decisions(first, second)
    slam_state = SlamState.restored(
        first.config,
        samples,
        mapper,
        trajectory,
        stamps,
        _transfer_checkpoint(state, other, mapper, kidnapped, shift),
        LoopAgreementState(last_search=mapper.travelled[-1], candidates=candidates),
        history.keyframe_scans,
    )
    return StoredSession(
        config=first.config,
        slam_state=slam_state,
        scans=scans,
        odometry=odometry,
        starts=starts,
        noise=second.noise,
        second_noise=second.second_noise,
        recordings=[*first.recordings, *second.recordings],
        queued_scans=second.queued_scans,
        loop_decisions=decisions,
    )


def _merge_maps(
    first: Mapper, second: Mapper, history: ScanHistory, model: OdometryModel, members: Sequence[PlacedSubmap]
) -> Mapper:
    """Return the solved map of both. Raises MapError if too few of the matched walls coincide.

    Tight loop factors of the members only move the second map into place. They are replaced by the walls that are
    merged then, and by the matches of the submaps with their own covariances.
    """
    motion = members[0].motion
    mapper = Mapper(merge_landmarks(first, second, motion))
    mapper.roughness.add_samples(np.concatenate([first.roughness.samples, second.roughness.samples]))
    poses = np.concatenate([first.keyframe_poses, se2.compose(motion, second.keyframe_poses)])
    odometry_wrong = np.zeros(len(history), dtype=bool)
    for k, (row, landmark_ids) in enumerate(zip(history.keyframes, merge_landmark_ids(first, second), strict=True)):
        features = history.scans[row].features
        odometry = None if k == 0 else motion_to_keyframe(k, history, model, odometry_wrong)
        mapper.add_keyframe_with_ids(poses[k], odometry, features.segments, features.corners, landmark_ids)
    mapper.graph.add_matches(merge_matches(first, second))
    matches = [_match_of(member, first) for member in members]
    temporary = [mapper.graph.add_loop(old, new, to, LOOP_FACTOR_COVARIANCE) for old, new, to, _ in matches]
    mapper.solve()
    mapper.recompute_pose_covariances()
    _merge_matched_walls(mapper, members, len(first.landmarks.walls))
    mapper.graph.remove_factors(temporary)
    for match in matches:
        mapper.graph.add_loop(*match)
    mapper.graph.update()
    converge(mapper)
    return mapper


def _match_of(member: PlacedSubmap, first: Mapper) -> tuple[int, int, se2.Pose, Floats]:
    """Return the match of a submap with the nearest keyframe of the first map.

    Returns the numbers of both keyframes in the merged map, the pose of the second in the frame of the first, and its
    covariance (3, 3).
    """
    nearest, relative = relative_to_nearest(first.keyframe_poses, member.pose)
    return nearest, member.keyframes[-1] + first.keyframe_count, relative, member.covariance


def _merge_matched_walls(mapper: Mapper, members: Sequence[PlacedSubmap], offset: int) -> None:
    """Merge the walls that coincide with those of submaps; `offset` is that of the second map's walls.

    Raises MapError.
    """
    rows = mapper.landmarks.walls.rows
    matched = np.concatenate([member.walls + np.array([0, offset]) for member in members])
    pairs = list(dict.fromkeys((int(rows["merged_into"][old]), int(rows["merged_into"][new])) for old, new in matched))
    coinciding = [
        (old, new)
        for old, new in pairs
        if find_overlaps(*(rows[name][[old, new]] for name in ("frame", "low", "high")))
    ]
    if 2 * len(coinciding) < len(pairs):
        raise MapError(f"only {len(coinciding)} of {len(pairs)} matched walls coincide")
    for old, new in coinciding:
        if old != new and rows["merged_into"][old] == old and rows["merged_into"][new] == new:
            mapper.merge_walls(old, new)
    mapper.graph.update()


def _transfer_checkpoint(
    first: SlamState, second: SlamState, mapper: Mapper, kidnapped: Sequence[int], shift: float
) -> TrackingCheckpoint:
    """Return the second state's checkpoint in the merged map, with the links of both between keyframes.

    `shift` (seconds) is added to its stamps.
    """
    keyframes, checkpoint = first.mapper.keyframe_count, second.checkpoint.shifted(shift)
    links = [(one + keyframes, other + keyframes) for one, other in checkpoint.field.links]
    links = [*first.checkpoint.field.links, *links]
    gaps = {keyframe + keyframes: gap for keyframe, gap in checkpoint.field.gaps.items()} | {keyframes: MAX_PATH}
    gaps |= first.checkpoint.field.gaps
    field = LocalFieldState(checkpoint.field.centre, links, gaps, (), np.zeros((0, 3)))  # of the map before
    checkpoint = replace(checkpoint, field=field, kidnapped_keyframes=kidnapped)
    if checkpoint.anchor is None or checkpoint.tracker is None:
        return checkpoint
    anchor = replace(checkpoint.anchor, keyframe=checkpoint.anchor.keyframe + keyframes)
    before = second.mapper.keyframe_poses[checkpoint.anchor.keyframe]
    motion = se2.compose(mapper.keyframe_poses[anchor.keyframe], se2.inverse(before))
    fix, reference = (
        replace(saved, pose=se2.compose(motion, saved.pose))
        for saved in (checkpoint.tracker.fix, checkpoint.tracker.reference)
    )
    return replace(checkpoint, tracker=replace(checkpoint.tracker, fix=fix, reference=reference), anchor=anchor)


def _merge_loop_decisions(first: StoredSession, second: StoredSession) -> tuple[list[Mapping[str, Any]], int]:
    """Return the loop decisions of both, those of the second with later keyframes and numbers, and the last number."""
    last, last_of_second = (
        max([session.slam_state.loops.state.candidates, *(int(row["candidate"]) for row in session.loop_decisions)])
        for session in (first, second)
    )
    keyframes = first.slam_state.mapper.keyframe_count
    offsets = {"candidate": last, "keyframe": keyframes, "old": keyframes}
    later = [{**row, **{name: row[name] + more for name, more in offsets.items()}} for row in second.loop_decisions]
    return [*first.loop_decisions, *later], last + last_of_second

"""Two sessions in one: all keyframes of both in one graph, held together where pieces were recognised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from drivers import se2

from ...errors import MapError
from ...estimation.refinement import build_scan_history
from ...estimation.refinement.iteration import motion_to
from ...estimation.refinement.scan_history import ScanHistory
from ...estimation.slam_state import SlamState, TrackingCheckpoint
from ...geometry.segments import Floats
from ...io.sessions import StoredSession
from ...loop_closure.closer import CARRYING_SIGMAS, LEAST_MERGED, LoopSearchState, together
from ...mapping.mapper import Mapper
from ...mapping.wall_roughness import WallRoughness
from ...odometry.error_model import OdometryModel
from .agreement import Agreement
from .carrying import Numbers, joined_landmarks, joined_names, joined_path, shift_after, shifted


def united(first: StoredSession, second: StoredSession, agreement: Agreement) -> StoredSession:
    """One session of two, the second where the agreement has it in the map of the first.

    Pieces that were recognised carry the second's map over, bent as it takes; the walls that lie on each other then are
    one. What both saw of the rest is not yet brought together: that is for refinement. The second's clock is set after
    the first's if it has to be. Raises MapError where the maps do not come together.
    """
    count, own = Numbers.of(first), second
    shift = shift_after(second, first.latest)
    second = shifted(second, shift)
    one, other = first.slam_state, own.slam_state
    model = OdometryModel(first.config.odometry)
    samples = np.concatenate([one.odometry_model.samples, other.odometry_model.samples])
    model.take(samples)
    path = joined_path(one.trajectory, other.trajectory, count.keyframes, shift)
    stamps = [*one.keyframe_stamps, *(stamp + shift for stamp in other.keyframe_stamps)]
    scans = [*first.scans, *second.scans]
    carried = [*one.kidnapped_keyframes, *(keyframe + count.keyframes for keyframe in other.kidnapped_keyframes)]
    starts = [*first.starts, *(row + count.scans for row in second.starts)]
    drive = build_scan_history(scans, path, stamps, carried, starts)
    motion = agreement.members[0].found.motion
    mapper = _solved(one.mapper, other.mapper, motion, drive, model, agreement)
    slam_state = SlamState.restored(
        first.config.odometry,
        samples,
        mapper,
        path,
        stamps,
        _standing(other, mapper, count.keyframes, carried),
        LoopSearchState(last_travel=mapper.travelled[-1]),
        {k: scans[row] for k, row in enumerate(drive.keyframes.tolist())},
    )
    return StoredSession(
        config=first.config,
        slam_state=slam_state,
        scans=scans,
        odometry=[*first.odometry, *second.odometry],
        starts=starts,
        sigma_range=second.sigma_range,
        recordings=[*first.recordings, *second.recordings],
        waiting=second.waiting,
        closures=[*first.closures, *_closures(second, count.keyframes)],
    )


def _solved(
    first: Mapper, second: Mapper, motion: se2.Pose, drive: ScanHistory, model: OdometryModel, agreement: Agreement
) -> Mapper:
    """The map of both. Raises MapError where too few of the walls that are the same come together."""
    walls = len(first.landmarks.walls)
    mapper = Mapper()
    mapper.landmarks = joined_landmarks(first, second, motion)
    mapper.roughness = WallRoughness()
    mapper.roughness.take(np.concatenate([first.roughness.samples, second.roughness.samples]))
    poses = np.concatenate([first.keyframe_poses, se2.compose(motion, second.keyframe_poses)])
    nowhere = np.zeros(len(drive), dtype=bool)
    for k, (row, landmark_ids) in enumerate(zip(drive.keyframes, joined_names(first, second), strict=True)):
        seen = drive.scans[row].features
        reached = None if k == 0 else motion_to(k, drive, model, poses, np.zeros((3, 3)), nowhere)
        mapper.extend(poses[k], reached, seen.segments, seen.corners, landmark_ids)
    for member in agreement.members:
        old = _nearest(first.keyframe_poses, member.found.pose)
        there = se2.between(first.keyframe_poses[old], member.found.pose)
        mapper.graph.tie_keyframes(old, member.keyframes[-1] + first.keyframe_count, there, CARRYING_SIGMAS)
    mapper.solve()
    mapper.remember_covariances()
    _make_one(mapper, agreement, walls)
    return mapper


def _nearest(keyframe_poses: Floats, pose: se2.Pose) -> int:
    return int(np.hypot(*(keyframe_poses[:, :2] - pose[:2]).T).argmin())


def _make_one(mapper: Mapper, agreement: Agreement, number: int) -> None:
    """Make one of the walls that were recognised in each other; the second map's are numbered on from `number`."""
    rows = mapper.landmarks.walls.rows
    found = np.concatenate([member.found.pairs + np.array([0, number]) for member in agreement.members])
    pairs = list(dict.fromkeys((int(rows["merged_into"][old]), int(rows["merged_into"][new])) for old, new in found))
    joined = [(old, new) for old, new in pairs if together(rows[old], rows[new])]
    if len(joined) < LEAST_MERGED * len(pairs):
        raise MapError(f"only {len(joined)} of {len(pairs)} walls that looked the same come together")
    for old, new in joined:
        if old != new and rows["merged_into"][old] == old and rows["merged_into"][new] == new:
            mapper.merge_walls(old, new)
    mapper.graph.update()
    mapper.settle()


def _standing(slam_state: SlamState, mapper: Mapper, keyframes: int, carried: Sequence[int]) -> TrackingCheckpoint:
    """Where the robot of a belief stands in a map in which its keyframes are numbered on from `keyframes`."""
    checkpoint = slam_state.checkpoint
    if checkpoint.anchor is None or checkpoint.firm is None:
        return replace(checkpoint, kidnapped_keyframes=carried)
    anchor = replace(checkpoint.anchor, keyframe=checkpoint.anchor.keyframe + keyframes)
    before = slam_state.mapper.keyframe_poses[checkpoint.anchor.keyframe]
    pose = se2.compose(mapper.keyframe_poses[anchor.keyframe], se2.between(before, checkpoint.firm.pose))
    firm = replace(checkpoint.firm, pose=pose)
    return replace(checkpoint, firm=firm, anchor=anchor, kidnapped_keyframes=carried)


def _closures(session: StoredSession, keyframes: int) -> list[dict[str, Any]]:
    """The decisions on places that looked known, with keyframes numbered on from `keyframes`."""
    return [
        {**closure, **{name: closure[name] + keyframes for name in ("keyframe", "old")}} for closure in session.closures
    ]

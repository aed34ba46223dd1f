"""Transfer a session into another session's map: shift its clock, transform its landmarks, and offset its indices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.timestamps import follows

from ...graph.factors import Factor
from ...io.sessions import StoredSession
from ...mapping.keyframes import LandmarkIds
from ...mapping.landmarks import Landmarks
from ...mapping.mapper import Mapper
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...odometry.history import OdometryHistory

MIN_CLOCK_GAP = 1.0
"""Seconds between two sessions if the clock of the second is shifted."""


@dataclass(frozen=True, slots=True)
class IndexOffsets:
    """Offsets of the indices of a session that is appended to another: the numbers of items of the other."""

    scans: int
    keyframes: int
    walls: int
    corners: int

    @classmethod
    def after(cls, session: StoredSession) -> IndexOffsets:
        """Return the offsets of what is appended to a session."""
        mapper = session.slam_state.mapper
        walls, corners = len(mapper.landmarks.walls), len(mapper.landmarks.corners)
        return cls(len(session.scans), mapper.keyframe_count, walls, corners)


def clock_shift(session: StoredSession, after: float) -> float:
    """Return the seconds to add to a session's stamps so that they follow `after` (seconds); 0 if they do."""
    starts = [float(history.stamps[0]) for history in session.odometry if len(history)]
    first = min([session.scans[0].stamp, *starts])
    return 0.0 if follows(first, after) else math.ceil(after - first) + MIN_CLOCK_GAP


def shift_clock(session: StoredSession, shift: float) -> StoredSession:
    """Return the session with `shift` seconds added to its stamps, except to those in its SLAM state."""
    return replace(
        session,
        scans=[replace(scan, stamp=scan.stamp + shift) for scan in session.scans],
        odometry=[OdometryHistory.from_arrays(history.stamps + shift, history.poses) for history in session.odometry],
        recordings=[
            recording.model_copy(update={name: getattr(recording, name) + shift for name in ("shift", "first", "last")})
            for recording in session.recordings
        ],
        queued_scans=[replace(scan, stamp=scan.stamp + shift) for scan in session.queued_scans],
        loop_decisions=[{**decision, "stamp": decision["stamp"] + shift} for decision in session.loop_decisions],
    )


def merge_landmarks(first: Mapper, second: Mapper, motion: se2.Pose) -> Landmarks:
    """Return the landmarks of both maps, those of the second appended; none is confirmed.

    `motion` (3,) transforms the second's frame into the first's.
    """
    walls, corners = first.landmarks.walls.rows, first.landmarks.corners.rows
    more_walls, more_corners = second.landmarks.walls.rows.copy(), second.landmarks.corners.rows.copy()
    more_walls["frame"] = se2.compose(motion, more_walls["frame"])
    more_walls["merged_into"] = _offset(more_walls["merged_into"], len(walls))
    for name in ("first_seen", "last_seen"):
        more_walls[name] += first.keyframe_count
    more_walls["removed_at"] = _offset(more_walls["removed_at"], first.keyframe_count)
    more_corners["position"] = se2.transform(motion, more_corners["position"])
    more_corners["headings"] = se2.wrap(more_corners["headings"] + motion[2])
    more_corners["walls"] = _offset(more_corners["walls"], len(walls))
    more_corners["last_seen"] += first.keyframe_count
    c, s = np.cos(motion[2]), np.sin(motion[2])
    rotation = np.array([[c, -s], [s, c]])
    more_corners["covariance"] = rotation @ more_corners["covariance"] @ rotation.T
    more_opened = {
        wall + len(walls): {cell: keyframe + first.keyframe_count for cell, keyframe in cells.items()}
        for wall, cells in second.landmarks.opened.items()
    }
    landmarks = Landmarks.from_tables(
        np.concatenate([walls, more_walls]),
        np.concatenate([corners, more_corners]),
        [*first.landmarks.covered, *second.landmarks.covered],
        first.landmarks.opened | more_opened,
        first.landmarks.parts.followed_by(second.landmarks.parts, first.keyframe_count),
    )
    landmarks.unconfirm_all()
    return landmarks


def merge_landmark_ids(first: Mapper, second: Mapper) -> list[LandmarkIds]:
    """Return the landmark ids of the keyframes of both maps, as in `merge_landmarks`; merged walls have one id."""
    walls, corners = len(first.landmarks.walls), len(first.landmarks.corners)
    more = [LandmarkIds(_offset(ids.walls, walls), _offset(ids.corners, corners)) for ids in _ids_after_merging(second)]
    return [*_ids_after_merging(first), *more]


def merge_matches(first: Mapper, second: Mapper) -> list[Factor]:
    """Return the scan matches and loop factors of both maps, with the second's keyframes after the first's."""
    offset = first.keyframe_count
    more = [
        replace(match, first=match.first + offset, second=match.second + offset) for match in second.graph.matches()
    ]
    return [*first.graph.matches(), *more]


def merge_trajectories(
    first: TrajectoryBuilder, second: TrajectoryBuilder, keyframes: int, shift: float
) -> TrajectoryBuilder:
    """Return the first trajectory followed by the second, which starts at keyframe `keyframes`, `shift` s later."""
    merged = TrajectoryBuilder()
    for part, offset, seconds in ((first, 0, 0.0), (second, keyframes, shift)):
        for stamp, keyframe, relative, information in zip(*part.relative_poses(), strict=True):
            merged.add(float(stamp) + seconds, int(keyframe) + offset, relative, information)
    return merged


def _ids_after_merging(mapper: Mapper) -> Sequence[LandmarkIds]:
    """Return the landmark ids of all keyframes, with the ids of merged walls replaced."""
    merged_into = mapper.landmarks.walls.rows["merged_into"]
    return [
        LandmarkIds(np.where(ids.walls >= 0, merged_into[ids.walls], -1), ids.corners) for ids in mapper.landmark_ids
    ]


def _offset(indices: NDArray[np.int64], offset: int) -> NDArray[np.int64]:
    """Return the indices plus an offset; negative values mean "none" and stay."""
    return np.asarray(np.where(indices >= 0, indices + offset, indices))

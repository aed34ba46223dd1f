"""A session as it stands in another's map: moved as one piece, its keyframes and landmarks numbered on from there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ...io.sessions import StoredSession
from ...mapping.keyframes import LandmarkIds
from ...mapping.landmarks import Landmarks
from ...mapping.mapper import Mapper
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...odometry.history import OdometryHistory

CLOCK_GAP = 1.0  # seconds between two sessions whose clocks have to be told apart


@dataclass(frozen=True, slots=True)
class Numbers:
    """How many there are of everything, so that what comes after is numbered on from there."""

    scans: int
    keyframes: int
    walls: int
    corners: int

    @classmethod
    def of(cls, session: StoredSession) -> Numbers:
        """Those of a session."""
        mapper = session.slam_state.mapper
        walls, corners = len(mapper.landmarks.walls), len(mapper.landmarks.corners)
        return cls(len(session.scans), mapper.keyframe_count, walls, corners)


def shift_after(session: StoredSession, after: float) -> float:
    """Seconds to add to the stamps of a session that they go on after a time (seconds); none if they do."""
    begins = [float(history.stamps[0]) for history in session.odometry if len(history)]
    first = min([session.scans[0].stamp, *begins])
    return 0.0 if first > after else math.ceil(after - first) + CLOCK_GAP


def shifted(session: StoredSession, shift: float) -> StoredSession:
    """The session with seconds added to its stamps. Its belief keeps its own."""
    return replace(
        session,
        scans=[replace(scan, stamp=scan.stamp + shift) for scan in session.scans],
        odometry=[OdometryHistory.of(history.stamps + shift, history.poses) for history in session.odometry],
        recordings=[
            recording.model_copy(update={name: getattr(recording, name) + shift for name in ("shift", "first", "last")})
            for recording in session.recordings
        ],
        waiting=[replace(scan, stamp=scan.stamp + shift) for scan in session.waiting],
        closures=[{**closure, "stamp": closure["stamp"] + shift} for closure in session.closures],
    )


def joined_landmarks(first: Mapper, second: Mapper, motion: se2.Pose) -> Landmarks:
    """The landmarks of both, those of the second moved and numbered after the first's. None is in a graph."""
    landmarks = Landmarks()
    walls, corners = first.landmarks.walls.rows, first.landmarks.corners.rows
    more_walls, more_corners = second.landmarks.walls.rows.copy(), second.landmarks.corners.rows.copy()
    more_walls["frame"] = se2.compose(motion, more_walls["frame"])
    more_walls["merged_into"] = _numbered(more_walls["merged_into"], len(walls))
    for name in ("first_seen", "last_seen"):
        more_walls[name] += first.keyframe_count
    more_walls["removed_at"] = _numbered(more_walls["removed_at"], first.keyframe_count)
    more_corners["position"] = se2.transform(motion, more_corners["position"])
    more_corners["headings"] = se2.wrap(more_corners["headings"] + motion[2])
    more_corners["walls"] = _numbered(more_corners["walls"], len(walls))
    more_corners["last_seen"] += first.keyframe_count
    c, s = np.cos(motion[2]), np.sin(motion[2])
    rotation = np.array([[c, -s], [s, c]])
    more_corners["covariance"] = rotation @ more_corners["covariance"] @ rotation.T
    landmarks.walls.fill(np.concatenate([walls, more_walls]))
    landmarks.corners.fill(np.concatenate([corners, more_corners]))
    landmarks.walls.rows["in_graph"] = landmarks.corners.rows["in_graph"] = False
    landmarks.covered = [*first.landmarks.covered, *second.landmarks.covered]
    landmarks.opened = {wall: dict(cells) for wall, cells in first.landmarks.opened.items()}
    for wall, cells in second.landmarks.opened.items():
        landmarks.opened[wall + len(walls)] = {cell: at + first.keyframe_count for cell, at in cells.items()}
    return landmarks


def joined_names(first: Mapper, second: Mapper) -> list[LandmarkIds]:
    """What the keyframes of both see, by the numbers in the joined landmarks; walls that are one by one name."""
    walls, corners = len(first.landmarks.walls), len(first.landmarks.corners)
    more = [
        LandmarkIds(_numbered(landmark_ids.walls, walls), _numbered(landmark_ids.corners, corners))
        for landmark_ids in _by_kept_walls(second)
    ]
    return [*_by_kept_walls(first), *more]


def joined_path(first: TrajectoryBuilder, second: TrajectoryBuilder, keyframes: int, shift: float) -> TrajectoryBuilder:
    """Both paths, one after the other; the second hangs on keyframes numbered on from `keyframes`, `shift` seconds
    later."""
    path = TrajectoryBuilder()
    for part, number, seconds in ((first, 0, 0.0), (second, keyframes, shift)):
        for stamp, keyframe, relative, information in zip(*part.hung(), strict=True):
            path.add(float(stamp) + seconds, int(keyframe) + number, relative, information)
    return path


def _by_kept_walls(mapper: Mapper) -> Sequence[LandmarkIds]:
    kept = mapper.landmarks.walls.rows["merged_into"]
    return [
        LandmarkIds(np.where(landmark_ids.walls >= 0, kept[landmark_ids.walls], -1), landmark_ids.corners)
        for landmark_ids in mapper.landmark_ids
    ]


def _numbered(identities: NDArray[np.int64], number: int) -> NDArray[np.int64]:
    """Identities numbered on from `number`; what is negative stands for none and stays."""
    return np.asarray(np.where(identities >= 0, identities + number, identities))

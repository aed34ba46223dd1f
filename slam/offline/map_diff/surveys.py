"""What a session states about a building: walls with their joint covariance, and what its scans have seen."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ...errors import MapError
from ...geometry.segments import Floats
from ...io.sessions import StoredSession
from ...io.wall_maps import wall_map_of
from ...mapping.wall_removal import MIN_STEP
from ...measuring.wall_map import WallGeometry
from ...recognition.location import OVERLAP
from ...recognition.location import locate as locate_drive
from ..map_merging.session_scans import drive_of, map_of
from ..wall_alignment import MIN_COMMON, align_maps

SAME_STAMP = 1e-3
"""Seconds between two stamps of one scan, one of which was shifted and back. Origin: numerical."""


@immutable
class Survey:
    """A settled session.

    session   the session; None for a plan in which no map is searched for
    wall_map  its walls
    poses     (k, 3) of scans with points, at least MIN_STEP metres of driving apart
    points    of each of these scans, (p, 2) in its frame
    scanned   false for a plan: views of its lines take the place of scans
    bridging  true for the lines of an earlier map without its scans: a line fitted to both sides of a door covers it
    hidden    (h, 2, 2) of its lines that no view shows, as in `PlanMap.hidden`
    """

    session: StoredSession | None
    wall_map: WallGeometry
    poses: Floats
    points: Sequence[Floats]
    scanned: bool = True
    bridging: bool = False
    hidden: Floats | None = None


def survey_session(path: Path, session: StoredSession) -> Survey:
    """Settle a session, which is changed; `path` is named in errors. Raises MapError."""
    return survey_settled(session, wall_map_of(path, session))


def survey_settled(session: StoredSession, wall_map: WallGeometry) -> Survey:
    """Return the survey of a session that has been settled, with its walls."""
    history = session.scan_history()
    poses = history.scan_poses(session.slam_state.mapper.keyframe_poses)
    chosen: list[int] = []
    for row in np.flatnonzero(history.has_features).tolist():
        if not chosen or np.hypot(*(poses[row, :2] - poses[chosen[-1], :2])) >= MIN_STEP:
            chosen.append(row)
    points = [np.ascontiguousarray(history.scans[row].features.points.xy) for row in chosen]
    return Survey(session, wall_map, poses[chosen], points)


def locate(old: Survey, new: Survey, guess: se2.Pose | None = None) -> se2.Pose:
    """Return the pose [x, y, heading] of the new map in the old one, by the walls that both contain.

    Without a guess, both maps have the scans that they share at the same place; without such scans, the new map is
    searched for in the old one. Raises MapError with the reason if it is not recognised there, or if the maps have too
    few walls in common.
    """
    if guess is None:
        guess = _pose_by_shared_scans(old, new)
    if guess is None:
        if old.session is None or new.session is None:
            raise ValueError("a survey without a session cannot be searched for")
        location = locate_drive(drive_of(new.session), map_of(old.session), OVERLAP)
        if not location.accepted:
            reason = f"the new one is not recognised: {location.reason}; --at states its rough pose"
            raise MapError(f"the maps cannot be aligned: {reason}")
        guess = location.members[len(location.members) // 2].motion
    motion, pairs = align_maps(old.wall_map.walls, new.wall_map.walls, guess)
    if len(pairs) < MIN_COMMON:
        raise MapError(f"the maps cannot be aligned: they have only {len(pairs)} walls in common")
    return motion


def shared_scans(old: Survey, new: Survey) -> list[tuple[int, int]]:
    """Return the rows of the scans that both sessions contain, in the old one and in the new one.

    There are some if one session was made from the other, or both from the same recording, whose stamps may have been
    shifted in one of them.
    """
    if old.session is None or new.session is None:
        return []
    scans, stamps = old.session.scans, _stamps_of_recordings(old.session)
    order, searched = np.argsort(stamps, kind="stable"), _stamps_of_recordings(new.session)
    bounds = [np.searchsorted(stamps[order], searched + more).tolist() for more in (-SAME_STAMP, SAME_STAMP)]
    shared = []
    for row, (scan, low, high) in enumerate(zip(new.session.scans, *bounds, strict=True)):
        points = scan.features.points.xy
        same = (k for k in order[low:high].tolist() if np.array_equal(scans[k].features.points.xy, points))
        shared += [(k, row) for k in islice(same, 1)]
    return shared


def _stamps_of_recordings(session: StoredSession) -> Floats:
    """Return the stamps (n,) of the scans as they were before those of a recording were shifted, seconds."""
    stamps = np.array([scan.stamp for scan in session.scans])
    if not session.recordings:
        return stamps
    begins = np.array([recording.first for recording in session.recordings])
    shifts = np.array([recording.shift for recording in session.recordings])
    rows = np.searchsorted(begins, stamps + SAME_STAMP) - 1
    return np.asarray(stamps - shifts[np.maximum(rows, 0)])


def _pose_by_shared_scans(old: Survey, new: Survey) -> se2.Pose | None:
    """Return the pose of the new map in the old one by the shared scan in the middle; None if there is none."""
    shared = shared_scans(old, new)
    if not shared:
        return None
    assert old.session is not None
    assert new.session is not None
    row, new_row = shared[len(shared) // 2]
    there, here = (
        session.scan_history().scan_poses(session.slam_state.mapper.keyframe_poses)[scan]
        for session, scan in ((old.session, row), (new.session, new_row))
    )
    return se2.compose(there, se2.inverse(here))

"""The scans of a session as a known map, and as a drive in submaps that is searched for in another one."""

from __future__ import annotations

from collections.abc import Sequence

from ...estimation.refinement.scan_history import ScanHistory
from ...geometry.segments import Floats
from ...io.sessions import StoredSession
from ...recognition.map_descriptor import express_in_frame
from ...recognition.map_index import index_map
from ...recognition.scanned_map import ScannedDrive, ScannedMap, scan_drive, scan_map, scan_submap
from .submaps import split_into_submaps

# Metres, side of a cell. Whole sessions have many cells, and larger ones depend less on each other. Sessions may
# overlap in a small part, which is all that decides then. Origin: chosen, with 1 m drives in worlds of equal places
# fit too well at the wrong one of them if the right one is not mapped.
SESSION_CELL = 2.0


def map_of(session: StoredSession) -> ScannedMap:
    """Prepare the map of a session that has keyframes to search in."""
    mapper = session.slam_state.mapper
    return scan_map(index_map(mapper), mapper.keyframe_poses, _keyframe_points(session.scan_history()), SESSION_CELL)


def drive_of(session: StoredSession) -> ScannedDrive:
    """Prepare a session that has keyframes to be searched for."""
    mapper, history = session.slam_state.mapper, session.scan_history()
    poses, points, scans = mapper.keyframe_poses, _keyframe_points(history), []
    for keyframes, walls in split_into_submaps(mapper, history):
        own = slice(keyframes.start, keyframes.stop)
        descriptor = express_in_frame(poses[keyframes[-1]], walls)
        scans.append(scan_submap(keyframes, descriptor, poses[own], points[own]))
    return scan_drive(mapper, scans, SESSION_CELL)


def _keyframe_points(history: ScanHistory) -> Sequence[Floats]:
    """Return the points (p, 6) of each keyframe with their normals, in its frame."""
    features = [history.scans[row].features for row in history.keyframes]
    return [some.surface_points() for some in features]

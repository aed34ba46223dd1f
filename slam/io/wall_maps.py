"""Read the walls of a session with their joint covariance."""

from __future__ import annotations

from pathlib import Path

from ..errors import MapError
from ..estimation.joint_covariance import joint_wall_covariance
from ..estimation.map_view import map_features
from ..estimation.wall_bends import settle_wall_bends
from ..mapping.convergence import converge
from ..mapping.mapper import Mapper
from ..measuring.wall_map import WallMap
from .output_dir import SESSION
from .sessions import StoredSession, is_session, read_session


def read_wall_map(path: Path | str) -> WallMap:
    """Read the session in the output directory of a run, and solve its graph for the joint covariance of the walls.

    Raises MapError naming the file and the problem, also if the session has no wall.
    """
    directory = Path(path)
    if directory.is_dir() and not is_session(directory):
        raise MapError(f"{path}: has no {SESSION}/, which covariances are computed from; name a mapping run")
    return wall_map_of(directory, read_session(directory))


def wall_map_of(path: Path, session: StoredSession) -> WallMap:
    """Settle a session, which is changed, and return its walls; `path` is named in errors. Raises MapError."""
    mapper = session.slam_state.mapper
    if not mapper.keyframe_count:
        raise MapError(f"{path}: has no keyframe, so it has no walls")
    converge(mapper)
    settle_wall_bends(mapper, session.scan_history())
    return settled_wall_map(mapper)


def settled_wall_map(mapper: Mapper) -> WallMap:
    """Return the walls of a map that has converged, with their joint covariance."""
    walls, corners = map_features(mapper, mapper.graph.marginals())
    return WallMap(walls, corners, joint_wall_covariance(mapper, walls), mapper.keyframe_poses[:, :2].copy())

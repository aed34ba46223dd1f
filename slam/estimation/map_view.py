"""The map as plain data, copied out of the estimate."""

from __future__ import annotations

import numpy as np

from drivers import se2

from ..events import Finished, MapCorners, MapWalls
from ..geometry.segments import Floats
from ..mapping.landmarks import Landmarks
from ..mapping.mapper import Mapper
from ..mapping.overlap_suppression import suppress_overlapping_walls
from .slam_state import SlamState

LEAST_SINE = 0.2  # of the angle between two walls that meet in a corner
STRAYED = 0.1  # metres from a corner beyond which its walls, as they are known now, no longer make it


def finished(slam_state: SlamState, path: tuple[Floats, Floats], summary: dict[str, object]) -> Finished:
    """What came of a belief that has settled, with all covariances; `path` is stamps (m,) and poses (m, 3)."""
    mapper = slam_state.mapper
    lines, corners = map_features(mapper, covariances=True)
    covariances = [mapper.keyframe_covariance(index) for index in range(mapper.keyframe_count)]
    return Finished(
        lines=lines,
        corners=corners,
        keyframe_stamps=np.array(slam_state.keyframe_stamps),
        keyframes=mapper.keyframe_poses,
        stamps=path[0],
        poses=path[1],
        summary=summary,
        keyframe_covariance=np.array(covariances).reshape(-1, 3, 3),
    )


def map_features(mapper: Mapper, *, covariances: bool) -> tuple[MapWalls, MapCorners]:
    """The confirmed walls, no two of them along the same stretch, and the corners; with the covariances of their
    marginals if asked for, about a millisecond each."""
    shown = suppress_overlapping_walls(mapper.landmarks)
    return _lines(mapper, shown, covariances=covariances), _corners(mapper, shown, covariances=covariances)


def _lines(mapper: Mapper, landmarks: Landmarks, *, covariances: bool) -> MapWalls:
    rows = landmarks.walls.rows
    chosen = np.flatnonzero(rows["in_graph"] & landmarks.active())
    covariance = np.full((len(chosen), 2, 2), np.nan)
    if covariances:
        for row, wall in enumerate(chosen):
            covariance[row] = mapper.graph.wall_covariance(int(wall))
        normals = np.column_stack([-np.sin(rows["frame"][chosen, 2]), np.cos(rows["frame"][chosen, 2])])
        covariance[:, 0, 0] += np.einsum(
            "ij,ijk,ik->i", normals, mapper.correlated_drift[rows["first_seen"][chosen]], normals
        )
    walls = rows[chosen]
    return MapWalls(
        identity=chosen,
        frame=walls["frame"].copy(),
        low=walls["low"].copy(),
        high=walls["high"].copy(),
        observations=walls["observations"].copy(),
        covariance=covariance,
        pieces=tuple(landmarks.pieces(int(wall)) for wall in chosen),
    )


def _corners(mapper: Mapper, landmarks: Landmarks, *, covariances: bool) -> MapCorners:
    """A corner lies on both of its walls, and they carry most of what was measured of it. So where both are in the map
    the corner is where they meet, with the covariance that follows from theirs; elsewhere it is its own estimate.
    """
    rows, walls = landmarks.corners.rows, landmarks.walls.rows
    chosen = np.flatnonzero(rows["in_graph"])
    chosen = chosen[landmarks.active_corners(chosen)]
    lines = np.full((len(chosen), 2), -1)
    position = rows["position"][chosen].copy()
    covariance = np.full((len(chosen), 2, 2), np.nan)
    met, jacobians = [], []  # rows of corners where both walls meet
    for row, corner in enumerate(chosen):
        named = rows["walls"][corner]
        lines[row] = np.where(named >= 0, walls["merged_into"][named], -1)
        first, second = (int(wall) for wall in lines[row])
        meeting = None
        turn = walls["frame"][second, 2] - walls["frame"][first, 2]
        if min(first, second) >= 0 and abs(np.sin(turn)) > LEAST_SINE and walls["in_graph"][[first, second]].all():
            meeting, jacobian = _meeting(walls["frame"][first], walls["frame"][second])
        if meeting is not None and np.hypot(*(meeting - position[row])) < STRAYED:
            position[row] = meeting
            met.append(row)
            jacobians.append(jacobian)
        elif covariances:
            covariance[row] = mapper.graph.corner_covariance(int(corner))
    if covariances and met:
        moved = np.array(jacobians)
        covariance[met] = moved @ mapper.graph.walls_covariances(lines[met]) @ moved.transpose(0, 2, 1)
    if covariances:  # nobody remembers from where a corner was seen first
        covariance += mapper.correlated_drift[rows["last_seen"][chosen]]
    return MapCorners(
        identity=chosen,
        position=position,
        covariance=covariance,
        lines=lines,
        observations=rows["observations"][chosen],
    )


def _meeting(first: se2.Pose, second: se2.Pose) -> tuple[Floats, Floats]:
    """Where two walls meet (2,), and how that moves (2, 4) with the offset and heading of either, at their frames.

    A point p is on a wall with normal n through o where n . (p - o) = 0. Shifting the wall by y across itself and
    turning it by t moves its line at p by y + s t, with s how far along the wall p is from o.
    """
    frames = np.stack([first, second])
    along = np.column_stack([np.cos(frames[:, 2]), np.sin(frames[:, 2])])
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    inverse = np.linalg.inv(normals)
    point = inverse @ np.einsum("ij,ij->i", normals, frames[:, :2])
    reach = np.einsum("ij,ij->i", along, point - frames[:, :2])
    jacobian = np.column_stack([inverse[:, 0], reach[0] * inverse[:, 0], inverse[:, 1], reach[1] * inverse[:, 1]])
    return point, jacobian


def covariances_when_last_seen(mapper: Mapper, lines: MapWalls, corners: MapCorners) -> tuple[Floats, Floats]:
    """(n, 2, 2) and (m, 2, 2): those of walls and corners in the map as they were when each was last seen, which costs
    nothing; NaN where they have not been told."""
    of_lines = mapper.landmarks.walls.rows["covariance_in_map"][lines.identity].copy()
    of_corners = mapper.landmarks.corners.rows["covariance_in_map"][corners.identity].copy()
    for covariance in (of_lines, of_corners):
        covariance[covariance[:, 0, 0] == 0.0] = np.nan
    return of_lines, of_corners

"""Copy map and trajectory out of the estimate as plain data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from features.corner_angle import MIN_SINE

from ..events import Finished
from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import SURFACE_DEPTH
from ..geometry.wall_intersection import intersect_walls
from ..graph.graph_estimate import Marginals
from ..mapping.drift_covariance import DriftCovariance
from ..mapping.landmarks import Landmarks
from ..mapping.map_features import Keyframes, MapCorners, MapWalls
from ..mapping.mapper import Mapper
from ..mapping.overlap_suppression import suppress_overlapping_walls
from .slam_state import SlamState

# Metres between a corner and the intersection of its walls above which the corner keeps its own estimate.
# Origin: definition.
MAX_INTERSECTION_DISTANCE = SURFACE_DEPTH


def final_result(
    state: SlamState, trajectory: tuple[Floats, Floats], sweep_covariances: Floats, summary: dict[str, object]
) -> Finished:
    """Return the result of a settled estimate with all covariances.

    trajectory         stamps (m,) and poses (m, 3)
    sweep_covariances  (k, 3, 3) of the keyframes, see `ScanFeatures`
    """
    mapper = state.mapper
    marginals, drift = mapper.graph.marginals(), DriftCovariance(mapper)
    walls, corners = _features(mapper, marginals, drift)
    covariance = mapper.covariances.of_all(marginals, drift) + sweep_covariances
    return Finished(
        walls=walls,
        corners=corners,
        keyframes=Keyframes(np.array(state.keyframe_stamps), mapper.keyframe_poses, covariance),
        stamps=trajectory[0],
        poses=trajectory[1],
        summary=summary,
    )


def map_features(mapper: Mapper, marginals: Marginals | None = None) -> tuple[MapWalls, MapCorners]:
    """Return the confirmed walls, no two of them along the same stretch, and the corners.

    Without `marginals`, those of the mapper's graph, covariances are NaN.
    """
    return _features(mapper, marginals, None if marginals is None else DriftCovariance(mapper))


def _features(
    mapper: Mapper, marginals: Marginals | None, drift: DriftCovariance | None
) -> tuple[MapWalls, MapCorners]:
    shown = suppress_overlapping_walls(mapper.landmarks)
    return _walls(shown, marginals, drift), _corners(mapper, shown, marginals, drift)


def _walls(landmarks: Landmarks, marginals: Marginals | None, drift: DriftCovariance | None) -> MapWalls:
    rows = landmarks.walls.rows
    chosen = np.flatnonzero(rows["in_graph"] & landmarks.active())
    covariance = np.full((len(chosen), 2, 2), np.nan)
    if marginals is not None and drift is not None:
        covariance = marginals.walls(chosen.tolist())
        normals = np.column_stack([-np.sin(rows["frame"][chosen, 2]), np.cos(rows["frame"][chosen, 2])])
        covariance[:, 0, 0] += np.einsum("ij,ijk,ik->i", normals, drift.of(rows["first_seen"][chosen]), normals)
    walls = rows[chosen]
    return MapWalls(
        identity=chosen,
        frame=walls["frame"].copy(),
        low=walls["low"].copy(),
        high=walls["high"].copy(),
        observations=walls["observations"].copy(),
        covariance=covariance,
        pieces=tuple(landmarks.pieces_of_walls(chosen)),
    )


def _corners(
    mapper: Mapper, landmarks: Landmarks, marginals: Marginals | None, drift: DriftCovariance | None
) -> MapCorners:
    """Return the corners.

    A corner lies on both of its walls, and they carry most of its information. If both are in the map, the corner is
    their intersection, with the covariance that follows from theirs; else it is the corner's own estimate. Corners at
    the intersection of the same two walls are one, with the identity of the oldest: their walls were merged.
    """
    rows, walls = landmarks.corners.rows, landmarks.walls.rows
    chosen = np.flatnonzero(rows["in_graph"])
    chosen = chosen[landmarks.active_corners(chosen)]
    position = rows["position"][chosen].copy()
    covariance = np.full((len(chosen), 2, 2), np.nan)
    named = rows["walls"][chosen]
    wall_ids = np.full((len(chosen), 2), -1)
    wall_ids[named >= 0] = walls["merged_into"][named[named >= 0]]
    intersecting = np.flatnonzero((wall_ids >= 0).all(axis=1))  # rows of corners at an intersection
    first, second = walls[wall_ids[intersecting]].T
    crossing = first["in_graph"] & second["in_graph"]
    crossing &= np.abs(np.sin(second["frame"][:, 2] - first["frame"][:, 2])) > MIN_SINE
    intersecting = intersecting[crossing]
    intersection, moved = intersect_walls(first["frame"][crossing], second["frame"][crossing])
    close = np.hypot(*(intersection - position[intersecting]).T) < MAX_INTERSECTION_DISTANCE
    intersecting, moved = intersecting[close], moved[close]
    position[intersecting] = intersection[close]
    if marginals is not None and drift is not None:
        covariance = marginals.corners(chosen.tolist())
        joint = np.array(mapper.graph.wall_covariances(wall_ids[intersecting].tolist())).reshape(-1, 4, 4)
        covariance[intersecting] = moved @ joint @ moved.transpose(0, 2, 1)
        # the keyframe that first saw a corner is not stored, the last one is
        covariance += drift.of(rows["last_seen"][chosen])
    kept, observations = _without_duplicates(wall_ids, intersecting, rows["observations"][chosen])
    return MapCorners(
        identity=chosen[kept],
        position=position[kept],
        covariance=covariance[kept],
        walls=wall_ids[kept],
        observations=observations[kept],
    )


def _without_duplicates(
    walls: Integers, intersecting: Integers, observations: Integers
) -> tuple[NDArray[np.bool_], Integers]:
    """Return (m,) which corners are the oldest of those at their intersection, and the observations (m,) of all these.

    walls         (m, 2) of each corner
    intersecting  (i,) rows of the corners at an intersection
    """
    kept, summed = np.ones(len(walls), dtype=bool), observations.copy()
    oldest: dict[tuple[int, int], int] = {}
    for row, (first, second) in zip(intersecting.tolist(), walls[intersecting].tolist(), strict=True):
        same = oldest.setdefault((first, second), row)
        if same != row:
            kept[row] = False
            summed[same] += observations[row]
    return kept, summed


def covariances_when_last_seen(mapper: Mapper, walls: MapWalls, corners: MapCorners) -> tuple[Floats, Floats]:
    """Return the covariances (n, 2, 2) of walls and (m, 2, 2) of corners from when each was last seen.

    These are stored and cost nothing; NaN if there is none.
    """
    of_walls = mapper.landmarks.walls.rows["covariance_in_map"][walls.identity].copy()
    of_corners = mapper.landmarks.corners.rows["covariance_in_map"][corners.identity].copy()
    for covariance in (of_walls, of_corners):
        covariance[covariance[:, 0, 0] == 0.0] = np.nan
    return of_walls, of_corners

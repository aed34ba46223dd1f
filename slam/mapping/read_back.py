"""Read landmarks and their covariances back from the graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers import se2

from ..geometry.segments import Floats, Integers
from ..graph.factor_graph import FactorGraph
from .keyframes import LandmarkIds
from .landmarks import Landmarks


def read_back_landmarks(landmarks: Landmarks, graph: FactorGraph, pose: se2.Pose, radius: float | None) -> None:
    """Read the estimates of the landmarks within `radius` metres of a pose back; if None, of all."""
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    near_walls = np.arange(len(walls)) if radius is None else landmarks.walls_near(pose, radius)
    near_corners = np.arange(len(corners)) if radius is None else landmarks.corners_near(pose, radius)
    near_walls = near_walls[walls["in_graph"][near_walls]]
    near_corners = near_corners[corners["in_graph"][near_corners]]
    walls["frame"][near_walls] = graph.wall_frames(near_walls)
    corners["position"][near_corners] = graph.corner_positions(near_corners)


def read_back_covariances(
    landmarks: Landmarks, graph: FactorGraph, last: int, observed: Sequence[LandmarkIds]
) -> Floats:
    """Store the covariances of the landmarks that the last keyframes observed: cheap right after an update.

    last      the last of these keyframes, to which the covariances are relative
    observed  landmark ids of these k keyframes, which follow each other

    Returns the covariances (k, 3, 3) of the keyframes' poses in the graph, along the map's axes.
    """
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    of_walls, of_corners = observed_landmarks(observed)
    observed_walls = of_walls[walls["in_graph"][of_walls]]
    observed_corners = of_corners[corners["in_graph"][of_corners]]
    keyframes = range(last + 1 - len(observed), last + 1)
    covariances = graph.relative_covariances(keyframes, observed_walls, observed_corners)
    landmarks.set_wall_covariances(observed_walls, covariances.walls, covariances.walls_in_map)
    landmarks.set_corner_covariances(observed_corners, covariances.corners, covariances.corners_in_map)
    return covariances.poses


def recompute_covariances(
    landmarks: Landmarks, graph: FactorGraph, walls: Sequence[int], corners: Sequence[int] = ()
) -> None:
    """Store the covariances of confirmed landmarks relative to the keyframes that observed them last, and in the map.

    Takes some milliseconds for each.
    """
    for wall in walls:
        last_seen = int(landmarks.walls.rows["last_seen"][wall])
        covariances = graph.relative_covariances([last_seen], [wall], [])
        landmarks.set_wall_covariances(np.array([wall]), covariances.walls, covariances.walls_in_map)
    for corner in corners:
        last_seen = int(landmarks.corners.rows["last_seen"][corner])
        covariances = graph.relative_covariances([last_seen], [], [corner])
        landmarks.set_corner_covariances(np.array([corner]), covariances.corners, covariances.corners_in_map)


def observed_landmarks(observed: Sequence[LandmarkIds]) -> tuple[Integers, Integers]:
    """Return the ids of the walls and of the corners that some keyframes observed, in ascending order."""
    return _distinct([ids.walls for ids in observed]), _distinct([ids.corners for ids in observed])


def _distinct(ids: Sequence[Integers]) -> Integers:
    """Return the ids that some arrays contain, in ascending order, without negative ones.

    A table is filled, as `is_among` does: `np.unique` takes several times as long.
    """
    numbers = np.concatenate(ids)
    present = np.zeros(1 + numbers.max(initial=-1), dtype=bool)
    present[numbers[numbers >= 0]] = True
    return np.flatnonzero(present)

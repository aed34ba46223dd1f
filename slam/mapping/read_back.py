"""Read landmarks and their covariances back from the graph."""

from __future__ import annotations

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..graph.factor_graph import FactorGraph
from .keyframes import KeyframeObservations
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
    landmarks: Landmarks, graph: FactorGraph, keyframe: int, observations: KeyframeObservations
) -> Floats:
    """Store the covariances of the landmarks that the last keyframe observed: cheap right after an update.

    Returns (3, 3) that of the keyframe's pose in the graph.
    """
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    association = observations.association
    observed_walls = np.unique(association.walls[association.walls >= 0])
    observed_walls = observed_walls[walls["in_graph"][observed_walls]]
    observed_corners = np.unique(association.corners[association.corners >= 0])
    observed_corners = observed_corners[corners["in_graph"][observed_corners]]
    covariances = graph.relative_covariances(keyframe, observed_walls, observed_corners)
    landmarks.set_wall_covariances(observed_walls, covariances.walls, covariances.walls_in_map)
    landmarks.set_corner_covariances(observed_corners, covariances.corners, covariances.corners_in_map)
    return covariances.pose

"""A room that is mapped twice, the second time with drift."""

from __future__ import annotations

import numpy as np

from drivers import se2
from slam.geometry.segments import Floats, Segments
from slam.mapping.landmarks import Landmarks

# Room with unequal sides and a niche: frames of the walls, seen from inside, and their half lengths.
ROOM = np.array(
    [
        [3.0, 0.0, 0.0, 3.0],
        [6.0, 2.0, np.pi / 2, 2.0],
        [4.5, 4.0, np.pi, 1.5],
        [3.0, 4.75, np.pi / 2, 0.75],
        [1.5, 5.5, np.pi, 1.5],
        [0.0, 2.75, -np.pi / 2, 2.75],
    ]
)
INSIDE = np.array([2.0, 2.0, 0.3])
# Covariances of the robot's pose relative to the old keyframe.
CERTAIN = np.diag([0.02, 0.02, 0.01]) ** 2
UNCERTAIN = np.diag([2.0, 2.0, 0.2]) ** 2


def add_walls(landmarks: Landmarks, walls: Floats, keyframe: int, moved: se2.Pose | None = None) -> list[int]:
    """Add confirmed walls (n, 4), all moved by `moved`, as seen from a keyframe; return their ids."""
    ids = []
    for wall in walls:
        frame = wall[:3] if moved is None else se2.compose(moved, wall[:3])
        wall_id = landmarks.add_wall(frame, wall[3], keyframe)
        landmarks.walls.rows["in_graph"][wall_id] = True
        landmarks.walls.rows["observations"][wall_id] = 2
        ids.append(wall_id)
    return ids


def map_twice(walls: Floats, drift: se2.Pose, distance: float = 60.0) -> tuple[Landmarks, se2.Pose, Floats]:
    """Map walls at the first keyframe, and again with `drift` after `distance` metres.

    Returns the landmarks, the robot's pose, and the travelled distances.
    """
    landmarks = Landmarks()
    add_walls(landmarks, walls, 0)
    add_walls(landmarks, walls, 1, drift)
    return landmarks, se2.compose(drift, INSIDE), np.array([0.0, distance])


def views_from(pose: se2.Pose, walls: Floats) -> list[tuple[se2.Pose, Segments]]:
    """Return a view of all walls (n, 4) from one pose."""
    frames = se2.between(pose, walls[:, :3])
    return [(pose, Segments(frames, walls[:, 3], np.tile(np.eye(2) * 1e-4, (len(walls), 1, 1))))]

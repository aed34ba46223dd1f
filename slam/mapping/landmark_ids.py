"""Assignment of landmark ids to the features of a keyframe, given their association with the local map."""

from __future__ import annotations

import numpy as np

from drivers import se2

from ..geometry.segments import CornerPoints, Floats, Integers, Segments
from .data_association import UNMATCHED, RowAssociation
from .keyframes import LandmarkIds
from .landmarks import Landmarks
from .local_map import LocalMap

# Metres from the base's origin below which a corner does not become a landmark: its bearing is undefined.
# Origin: chosen, within the outline of the robot; not measured.
MIN_CORNER_RANGE = 0.2


def assign_landmark_ids(
    landmarks: Landmarks,
    keyframe: int,
    pose: se2.Pose,
    segments: Segments,
    corners: CornerPoints,
    association: RowAssociation,
    local_map: LocalMap,
    points: Floats,
) -> LandmarkIds:
    """Record in `landmarks` what a keyframe at `pose` has seen, and return the landmark ids of its features.

    A matched feature is an observation of its landmark, an unmatched one becomes a new landmark, and an ambiguous one
    gets the id -1. `points` (p, 2) are those of the scan, in its frame.
    """
    walls = _assign_walls(landmarks, keyframe, pose, segments, association, local_map, points)
    return LandmarkIds(walls, _assign_corners(landmarks, keyframe, pose, corners, walls, association, local_map))


def _assign_walls(
    landmarks: Landmarks,
    keyframe: int,
    pose: se2.Pose,
    segments: Segments,
    association: RowAssociation,
    local_map: LocalMap,
    points: Floats,
) -> Integers:
    frames = se2.compose(pose, segments.frame).reshape(-1, 3)
    in_map = se2.transform(pose, points).reshape(-1, 2)
    ids = np.full(len(segments), -1)
    for i, row in enumerate(association.walls):
        if row >= 0:
            ids[i] = local_map.walls[row]
            landmarks.observe_wall(int(ids[i]), frames[i], segments.half_length[i], keyframe, in_map)
        elif row == UNMATCHED:
            ids[i] = landmarks.add_wall(frames[i], segments.half_length[i], keyframe, in_map)
    return ids


def _assign_corners(
    landmarks: Landmarks,
    keyframe: int,
    pose: se2.Pose,
    corners: CornerPoints,
    walls: Integers,
    association: RowAssociation,
    local_map: LocalMap,
) -> Integers:
    """Return the ids of the corners; `walls` (n,) are those of the segments."""
    positions = se2.transform(pose, corners.position).reshape(-1, 2)
    headings = se2.wrap(corners.headings + pose[2])
    ids = np.full(len(corners), -1)
    for i, row in enumerate(association.corners):
        if row >= 0:
            ids[i] = local_map.corners[row]
            landmarks.observe_corner(int(ids[i]), headings[i], keyframe)
        elif row == UNMATCHED and np.hypot(*corners.position[i]) > MIN_CORNER_RANGE:
            ids[i] = landmarks.add_corner(positions[i], headings[i], walls[corners.segments[i]], keyframe)
    return ids

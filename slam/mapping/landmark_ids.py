"""Which landmarks a keyframe saw, by identity: what an association means for the map."""

from __future__ import annotations

import numpy as np

from drivers import se2

from ..geometry.segments import CornerPoints, Integers, Segments
from .data_association import UNMATCHED, Association
from .keyframes import LandmarkIds
from .landmarks import Landmarks
from .local_map import LocalMap

SMALLEST_REACH = 0.2  # metres: a corner nearer to the base's origin has no bearing to speak of


def assign_landmark_ids(
    landmarks: Landmarks,
    keyframe: int,
    pose: se2.Pose,
    segments: Segments,
    corners: CornerPoints,
    association: Association,
    local_map: LocalMap,
) -> LandmarkIds:
    """What a keyframe at `pose` saw; landmarks are seen again, or for the first time and made."""
    walls = _name_walls(landmarks, keyframe, pose, segments, association, local_map)
    return LandmarkIds(walls, _name_corners(landmarks, keyframe, pose, corners, walls, association, local_map))


def _name_walls(
    landmarks: Landmarks,
    keyframe: int,
    pose: se2.Pose,
    segments: Segments,
    association: Association,
    local_map: LocalMap,
) -> Integers:
    """The identity of the wall each segment shows (-1: ambiguous), walls seen for the first time made."""
    frames = se2.compose(pose, segments.frame).reshape(-1, 3)
    named = np.full(len(segments), -1)
    for i, row in enumerate(association.walls):
        if row >= 0:
            named[i] = local_map.walls[row]
            landmarks.observe_wall(int(named[i]), frames[i], segments.half_length[i], keyframe)
        elif row == UNMATCHED:
            named[i] = landmarks.add_wall(frames[i], segments.half_length[i], keyframe)
    return named


def _name_corners(
    landmarks: Landmarks,
    keyframe: int,
    pose: se2.Pose,
    corners: CornerPoints,
    walls: Integers,
    association: Association,
    local_map: LocalMap,
) -> Integers:
    """The identity of each corner (-1: ambiguous), corners seen for the first time made."""
    positions = se2.transform(pose, corners.position).reshape(-1, 2)
    headings = se2.wrap(corners.headings + pose[2])
    named = np.full(len(corners), -1)
    for i, row in enumerate(association.corners):
        if row >= 0:
            named[i] = local_map.corners[row]
            landmarks.observe_corner(int(named[i]), headings[i], keyframe)
        elif row == UNMATCHED and np.hypot(*corners.position[i]) > SMALLEST_REACH:
            named[i] = landmarks.add_corner(positions[i], headings[i], walls[corners.segments[i]], keyframe)
    return named

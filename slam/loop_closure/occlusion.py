"""Occlusion check of a loop closure hypothesis: the share of what was seen that reference walls would have hidden."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import Floats, Integers, Segments
from ..geometry.surroundings import ROOM_SIZE
from ..mapping.landmarks import Landmarks
from ..mapping.wall_removal import RIGID_DISTANCE

# Metres of driving since a wall was first seen from which on it is old, and metres from the robot up to which it is
# considered.
OLD_DISTANCE = RIGID_DISTANCE
# Metres of driving without an observation from which on an old wall is not seen any more.
# Origin: definition, the robot has left the room.
RECENT_DISTANCE = ROOM_SIZE
# Positions on a segment, from -1 to 1 between its ends, to which lines of sight are drawn.
# Origin: chosen, the middle and both ends without their outermost parts; not measured.
SIGHT_LINE_TARGETS = (-0.8, 0.0, 0.8)
# Metres by which lines of sight end before the segment seen, and by which reference walls are shortened at both ends.
# Origin: chosen, for errors of the poses; not measured.
OCCLUSION_MARGIN = 0.3


def old_walls(landmarks: Landmarks, pose: se2.Pose, travelled: Floats, before: float) -> Integers:
    """Return the ids (n,) of walls near a pose that were first seen long ago, and not recently.

    travelled  (k,) metres driven up to each keyframe
    before     metres driven; only walls first seen before that count
    """
    walls = landmarks.walls.rows
    first_seen, last_seen = travelled[walls["first_seen"]], travelled[walls["last_seen"]]
    old = walls["in_graph"] & landmarks.active() & (travelled[-1] - last_seen > RECENT_DISTANCE)
    old &= first_seen < min(before, travelled[-1] - OLD_DISTANCE)
    viewpoint = se2.transform(se2.inverse(walls["frame"]), pose[:2]).reshape(-1, 2)
    beyond = np.maximum(0.0, np.maximum(walls["low"] - viewpoint[:, 0], viewpoint[:, 0] - walls["high"]))
    return np.flatnonzero(old & (np.hypot(beyond, viewpoint[:, 1]) < OLD_DISTANCE))


def occluded_share(
    motion: se2.Pose, walls: Integers, landmarks: Landmarks, views: Sequence[tuple[se2.Pose, Segments]]
) -> float:
    """Return the share of the wall length seen in `views` that old walls would have hidden.

    motion  of the robot in the map, [x, y, heading]
    walls   (n,) ids of the old walls; they hide what is behind them where they were observed
    views   poses in the map, each with the segments seen from there
    """
    viewpoints, targets, weights = _sight_lines(motion, views)
    if not len(viewpoints) or not len(walls):
        return 0.0
    rows = landmarks.walls.rows[walls]
    low, high = rows["low"] + OCCLUSION_MARGIN, rows["high"] - OCCLUSION_MARGIN
    blocked = np.zeros(len(viewpoints), dtype=bool)
    # a copy is contiguous: compiled for a column of several walls, the function would be compiled again for one wall
    for ray, row, along in _find_crossings(viewpoints, targets, rows["frame"].copy(), low, high):
        blocked[ray] |= landmarks.is_covered(int(walls[row]), along)
    return float(weights[blocked].sum() / weights.sum())


@compiled
def _find_crossings(viewpoints, targets, frames, lows, highs):  # type: ignore[no-untyped-def]
    """Find the crossings of lines of sight with walls between the walls' ends.

    Returns a list of (row of `viewpoints`, row of `frames`, metres along the wall).
    """
    found = []
    for row in range(len(frames)):
        x, y = frames[row, 0], frames[row, 1]
        c, s = math.cos(frames[row, 2]), math.sin(frames[row, 2])
        for ray in range(len(viewpoints)):
            ex, ey = viewpoints[ray, 0] - x, viewpoints[ray, 1] - y
            tx, ty = targets[ray, 0] - x, targets[ray, 1] - y
            view_side, target_side = c * ey - s * ex, c * ty - s * tx
            if view_side * target_side < 0.0:
                part = view_side / (view_side - target_side)
                along = c * (ex + part * (tx - ex)) + s * (ey + part * (ty - ey))
                if lows[row] < along < highs[row]:
                    found.append((ray, row, along))
    return found


def _sight_lines(motion: se2.Pose, views: Sequence[tuple[se2.Pose, Segments]]) -> tuple[Floats, Floats, Floats]:
    """Return the lines of sight of the views after a motion of the robot.

    Returns viewpoints (r, 2), targets (r, 2) shortly before the segments, and the wall lengths (r,) they stand for.
    """
    if not views:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    poses = se2.compose(motion, np.array([pose for pose, _ in views]))
    frames = np.concatenate([se2.compose(pose, seen.frame) for pose, (_, seen) in zip(poses, views, strict=True)])
    viewpoints = np.repeat(poses[:, :2], [len(segments) for _, segments in views], axis=0)
    halves = np.concatenate([segments.half_length for _, segments in views])
    along = np.column_stack([np.cos(frames[:, 2]), np.sin(frames[:, 2])])
    seen = np.concatenate([frames[:, :2] + part * halves[:, None] * along for part in SIGHT_LINE_TARGETS])
    viewpoints, weights = np.tile(viewpoints, (len(SIGHT_LINE_TARGETS), 1)), np.tile(halves, len(SIGHT_LINE_TARGETS))
    distance = np.hypot(*(seen - viewpoints).T)
    shorter = np.maximum(0.0, 1.0 - OCCLUSION_MARGIN / np.maximum(distance, 1e-9))
    return viewpoints, viewpoints + shorter[:, None] * (seen - viewpoints), weights

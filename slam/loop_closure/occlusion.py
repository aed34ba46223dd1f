"""Occlusion check of a loop closure hypothesis: the share of what was seen that reference walls would have hidden."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import Floats, Segments
from ..mapping.landmarks import Landmarks
from .recent_walls import ReferenceMap

# Positions on a segment, from -1 to 1 between its ends, to which lines of sight are drawn.
# Origin: chosen, the middle and both ends without their outermost parts; not measured.
SIGHT_LINE_TARGETS = (-0.8, 0.0, 0.8)
# Metres by which lines of sight end before the segment seen, and by which reference walls are shortened at both ends.
# Origin: chosen, for errors of the poses; not measured.
OCCLUSION_MARGIN = 0.3


def occluded_share(
    motion: se2.Pose, reference: ReferenceMap, landmarks: Landmarks, views: Sequence[tuple[se2.Pose, Segments]]
) -> float:
    """Return the share of the wall length seen in `views` that reference walls would have hidden.

    motion     of the robot in the map, [x, y, heading]
    reference  only its walls that were not seen recently, where they were observed, hide anything
    views      poses in the map, each with the segments seen from there
    """
    viewpoints, targets, weights = _sight_lines(motion, views)
    walls = reference.wall_set.walls[reference.not_recent]
    if not len(viewpoints) or not len(walls):
        return 0.0
    rows = landmarks.walls.rows[walls]
    low, high = rows["low"] + OCCLUSION_MARGIN, rows["high"] - OCCLUSION_MARGIN
    blocked = np.zeros(len(viewpoints), dtype=bool)
    for ray, row, along in _find_crossings(viewpoints, targets, rows["frame"], low, high):
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

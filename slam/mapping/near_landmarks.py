"""Landmarks within some distance of a position, in compiled code: they are selected several times at each keyframe.

Both functions take the tables of walls and corners themselves, as columns would be copied at each call.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled, inlined

from .landmark_table import NEVER_REMOVED

# Metres by which the robot may be behind a wall's line and still be about to see the wall: covers drift, and the far
# ends of long walls. Origin: chosen, more than the drift within a local map; not measured.
BEHIND_MARGIN = 0.5
# Metres by which rounding may change a distance. Origin: numerical.
ROUNDING = 1e-6
# In place of a keyframe, after all others: walls count as removed whenever they were removed. Origin: definition.
NO_KEYFRAME = np.iinfo(np.int64).max


@compiled
def near_walls(walls, x, y, radius, keyframe):  # type: ignore[no-untyped-def]
    """Return the rows of the active walls with a part near (x, y) on their visible side, in ascending order."""
    near, count = np.empty(len(walls), np.int64), 0
    for j in range(len(walls)):
        wall = walls[j]
        if wall.merged_into != j or _is_gone(wall.removed_at, keyframe):
            continue
        dx, dy, low, high = x - wall.frame[0], y - wall.frame[1], wall.low, wall.high
        if is_beyond_reach(dx, dy, low, high, radius):
            continue
        c, s = math.cos(wall.frame[2]), math.sin(wall.frame[2])
        along, ahead = c * dx + s * dy, c * dy - s * dx  # the pose as seen from the wall's frame
        beyond = max(0.0, low - along, along - high)
        if ahead > -BEHIND_MARGIN and beyond * beyond + ahead * ahead < radius * radius:
            near[count] = j
            count += 1
    return near[:count]


@compiled
def near_corners(corners, walls, x, y, radius, keyframe):  # type: ignore[no-untyped-def]
    """Return the rows of the active corners within `radius` metres of (x, y), in ascending order."""
    near, count = np.empty(len(corners), np.int64), 0
    for j in range(len(corners)):
        corner = corners[j]
        dx, dy = corner.position[0] - x, corner.position[1] - y
        if not dx * dx + dy * dy < radius * radius:  # a dropped corner is at NaN
            continue
        there = True
        for k in range(2):
            wall = corner.walls[k]
            kept = walls[wall].merged_into if wall >= 0 else -1
            there = there and not (kept >= 0 and _is_gone(walls[kept].removed_at, keyframe))
        if there:
            near[count] = j
            count += 1
    return near[:count]


@inlined
def is_beyond_reach(dx, dy, low, high, radius):  # type: ignore[no-untyped-def]
    """Return True if a wall from `low` to `high` (metres), in any direction, is farther than `radius` from (dx, dy).

    (dx, dy) is relative to the wall's frame. Most walls are, and need no sine and cosine of their direction.
    """
    reach = radius + max(abs(low), abs(high)) + ROUNDING
    return dx * dx + dy * dy > reach * reach


@inlined
def _is_gone(removed_at, keyframe):  # type: ignore[no-untyped-def]
    """Return True if a wall was removed before a keyframe; NO_KEYFRAME is after all."""
    return removed_at != NEVER_REMOVED and removed_at < keyframe

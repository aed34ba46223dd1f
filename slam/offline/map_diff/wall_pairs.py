"""Walls of two maps that are the same, or one of which may have been moved to become the other."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from ...geometry.segments import Floats, Integers
from ...mapping.map_features import MapWalls
from ...mapping.plan_walls import MIN_COMMON_LENGTH
from ..wall_alignment import GATES, common_walls

# Metres across and radians by which a wall may have moved at most: farther apart, the old wall is gone and the new one
# is another wall. Origin: chosen; not measured.
MAX_SHIFT, MAX_TURN = 0.5, math.radians(10.0)
# Metres across and radians within which walls are the same until a test shows that one has moved.
# Origin: definition, the last gate of the alignment.
SAME_SHIFT, SAME_TURN = GATES[-1][0], math.radians(GATES[-1][1])


def find_pairs(old: MapWalls, new: MapWalls, motion: se2.Pose) -> Integers:
    """Return the rows (n, 2) of walls that are the same, or one of which may have been moved."""
    near = common_walls(old, new, motion, SAME_SHIFT, SAME_TURN)
    near = near[_shared_lengths(old, new, near, motion) >= MIN_COMMON_LENGTH]
    far = common_walls(old, new, motion, MAX_SHIFT, MAX_TURN)
    far = far[_shared_lengths(old, new, far, motion) >= MIN_COMMON_LENGTH]
    fresh = ~np.isin(far[:, 0], near[:, 0]) & ~np.isin(far[:, 1], near[:, 1])
    return np.concatenate([near, far[fresh]])


def without_hidden(pairs: Integers, old: MapWalls, new: MapWalls, motion: se2.Pose, hidden: Floats) -> Integers:
    """Return the pairs (n, 2) without those whose new wall is nearer to a hidden line of the plan than to the old wall.

    hidden  (h, 2, 2) lines of the plan that no view shows, because of what is in front of them

    Such a new wall is the hidden line, seen because the old wall in front of it is gone: nothing has moved.
    """
    in_old, ends_of_old = se2.compose(motion, new.frame), old.end_points()
    kept = []
    for row, number in pairs.tolist():
        ends = np.asarray(se2.transform(se2.inverse(in_old[number]), np.concatenate([ends_of_old[[row]], hidden])))
        along = ends[:, 1] - ends[:, 0]
        low = np.maximum(ends[..., 0].min(axis=1), new.low[number])
        high = np.minimum(ends[..., 0].max(axis=1), new.high[number])
        turn = np.arctan2(along[:, 1], along[:, 0])
        offset = np.abs(ends[:, 0, 1] + (0.5 * (low + high) - ends[:, 0, 0]) * np.tan(turn))
        same = (high - low > MIN_COMMON_LENGTH) & (np.abs(turn) < SAME_TURN) & (offset < SAME_SHIFT)
        kept.append(not (same[1:] & (offset[1:] < offset[0])).any())
    return pairs[kept]


def _shared_lengths(old: MapWalls, new: MapWalls, pairs: Integers, motion: se2.Pose) -> Floats:
    """Return the metres (n,) along which pieces of both walls of a pair are next to each other."""
    frames = se2.compose(motion, new.frame).reshape(-1, 3)
    lengths = []
    for one, two in pairs.tolist():
        shift = float(se2.between(old.frame[one], frames[two])[0])
        low = np.maximum(old.pieces[one][:, None, 0], new.pieces[two][None, :, 0] + shift)
        high = np.minimum(old.pieces[one][:, None, 1], new.pieces[two][None, :, 1] + shift)
        lengths.append(float(np.maximum(high - low, 0.0).sum()))
    return np.array(lengths)

"""Align two maps of one building by the walls that both contain.

Pairs of walls are found by position alone: if the covariances influenced the selection, tests of the differences would
be biased.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from drivers import se2

from ..geometry.segments import Floats, Integers
from ..mapping.map_features import MapWalls
from ..mapping.plan_walls import MIN_COMMON_LENGTH

GATES = ((0.5, 10.0), (0.3, 6.0), (0.2, 4.0), (0.2, 4.0))
"""Metres across and degrees between two walls that can be the same, for one iteration of the alignment after the other.
The last one is far above any stated standard deviation, so that it hardly selects good pairs."""
ALIGNMENT_SIGMAS = np.array([0.03, math.radians(0.5)])
"""Metres across and radians: residuals at which the weight of a pair is one half while maps are aligned."""
ALIGNMENT_STEPS = 10
"""Iterations for the weights of each gate."""
MIN_COMMON = 4
"""Common walls for a comparison: three determine the alignment."""


def align_maps(first: MapWalls, second: MapWalls, motion: se2.Pose) -> tuple[se2.Pose, Integers]:
    """Return the pose of the second map in the first one, and the rows (n, 2) of their common walls.

    `motion` is a first guess. Pairs are matched by position, and the motion is estimated by robust least squares with
    equal weights, whatever the covariances state.
    """
    pairs = np.zeros((0, 2), dtype=np.int64)
    for across, turn in GATES:
        pairs = common_walls(first, second, motion, across, math.radians(turn))
        if len(pairs) < MIN_COMMON:
            return motion, pairs
        points = shared_points(first, second, pairs, motion)
        for _ in range(ALIGNMENT_STEPS):
            motion = se2.compose(motion, _alignment_step(first, second, pairs, points, motion))
    return motion, pairs


def _alignment_step(first: MapWalls, second: MapWalls, pairs: Integers, points: Floats, motion: se2.Pose) -> se2.Pose:
    """Return the change of the motion by one step of iteratively reweighted least squares."""

    def scaled(change: Floats) -> Floats:
        differences = wall_differences(first, second, pairs, points, se2.compose(motion, change))
        return np.asarray((differences / ALIGNMENT_SIGMAS).ravel())

    values, jacobian = scaled(np.zeros(3)), numerical_jacobian(scaled)
    root_weight = 1.0 / np.sqrt(1.0 + values**2)
    solution = np.linalg.lstsq(root_weight[:, None] * jacobian, -root_weight * values, rcond=None)
    return np.asarray(solution[0], dtype=np.float64)


def common_walls(first: MapWalls, second: MapWalls, motion: se2.Pose, across: float, turn: float) -> Integers:
    """Return the rows (n, 2) of walls that can be the same: mutually nearest, and within the gates.

    motion        pose of the second map in the first one
    across, turn  gates: metres across and radians between two walls
    """
    frames = se2.compose(motion, second.frame)
    ends = np.stack([second.low, second.high], axis=1)
    relative = se2.between(first.frame[:, None], frames[None])  # (first, second, 3)
    along = relative[..., 0, None] + np.cos(relative[..., 2, None]) * ends[None]
    low = np.maximum(along.min(axis=-1), first.low[:, None])
    high = np.minimum(along.max(axis=-1), first.high[:, None])
    middle = 0.5 * (low + high)
    offset = np.abs(relative[..., 1] + (middle - relative[..., 0]) * np.tan(relative[..., 2]))
    possible = (high - low > MIN_COMMON_LENGTH) & (np.abs(relative[..., 2]) < turn) & (offset < across)
    offset = np.where(possible, offset, np.inf)
    if not offset.size:
        return np.zeros((0, 2), dtype=np.int64)
    nearest, back = offset.argmin(axis=1), offset.argmin(axis=0)
    rows = np.flatnonzero(possible.any(axis=1))
    rows = rows[back[nearest[rows]] == rows]
    return np.column_stack([rows, nearest[rows]]).astype(np.int64)


def shared_points(first: MapWalls, second: MapWalls, pairs: Integers, motion: se2.Pose) -> Floats:
    """Return the position (n, 2) along each wall of a pair, from its frame, of the middle of their common part."""
    one, two = pairs.T
    relative = se2.between(first.frame[one], se2.compose(motion, second.frame[two]))
    low = np.maximum(relative[:, 0] + second.low[two], first.low[one])
    high = np.minimum(relative[:, 0] + second.high[two], first.high[one])
    middle = 0.5 * (low + high)
    return np.column_stack([middle, middle - relative[:, 0]])


def wall_differences(first: MapWalls, second: MapWalls, pairs: Integers, points: Floats, motion: se2.Pose) -> Floats:
    """Return the offset across and the heading (n, 2) of the second map's walls relative to the first's.

    The offset is that at `points`, as from `shared_points`; the second map is at `motion` in the first.
    """
    one, two = pairs.T
    zero = np.zeros(len(pairs))
    here = se2.compose(first.frame[one], np.column_stack([points[:, 0], zero, zero]))
    there = se2.compose(motion, se2.compose(second.frame[two], np.column_stack([points[:, 1], zero, zero])))
    relative = se2.between(here, there)
    return np.column_stack([relative[:, 1] - relative[:, 0] * np.tan(relative[:, 2]), relative[:, 2]])


def numerical_jacobian(function: Callable[[Floats], Floats]) -> Floats:
    """Return the derivative (m, 3) of a function of a small motion at zero, by central differences."""
    step = 1e-5
    columns = [(function(step * axis) - function(-step * axis)) / (2.0 * step) for axis in np.eye(3)]
    return np.column_stack(columns)

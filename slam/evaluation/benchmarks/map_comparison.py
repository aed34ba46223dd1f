"""Compare the walls that two maps of one building have in common with the joint covariances of both maps.

The maps are made from independent measurements. Their common walls should differ by what the covariances state, except
for the motion between the two maps' frames, which is estimated. Pairs of walls are found by position alone: if the
covariances influenced the selection, the NEES would be biased.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers import se2

from ...events import Finished
from ...geometry.segments import Floats, Integers
from ...io.tum import Trajectory
from ...mapping.map_features import MapWalls
from ...mapping.mapper import Mapper
from ...pipeline import Slam
from ..nees import GROSS, chi_square_quantile

GATES = ((0.5, 10.0), (0.3, 6.0), (0.2, 4.0), (0.2, 4.0))
"""Metres across and degrees between two walls that can be the same, for one iteration of the alignment after the other.
The last one is far above any stated standard deviation, so that it hardly selects good pairs."""
MIN_SHARED = 0.5
"""Metres along which two walls must overlap to be the same."""
ALIGNMENT_SIGMAS = np.array([0.03, math.radians(0.5)])
"""Metres across and radians: residuals at which the weight of a pair is one half while maps are aligned."""
ALIGNMENT_STEPS = 10
"""Iterations for the weights of each gate."""
MIN_COMMON = 4
"""Common walls for a comparison: three determine the alignment."""


@dataclass(frozen=True, slots=True)
class MapComparison:
    """Walls that are in two maps of one building.

    common  number of these walls
    nees    per dimension, of all together, with the joint covariances of both maps; 1 is consistent
    median  median NEES of each wall by itself, relative to that of the chi-square distribution; 1 is consistent, and
            walls that are wrongly paired have little influence
    gross   share of these walls with a NEES beyond the quantile GROSS
    """

    common: int
    nees: float
    median: float
    gross: float


def compare_maps(first: tuple[Slam, Finished], second: tuple[Slam, Finished], path: Trajectory) -> MapComparison | None:
    """Compare the common walls of two maps; `path` is that of the whole drive, for the first alignment.

    Returns None with fewer than MIN_COMMON common walls.
    """
    (slam, map_1), (other, map_2) = first, second
    starts = path.at([finished.keyframe_stamps[0] for _, finished in (first, second)]).poses
    motion, pairs = align_maps(map_1.walls, map_2.walls, se2.between(starts[0], starts[1]))
    if len(pairs) < MIN_COMMON:
        return None
    points = _shared_points(map_1.walls, map_2.walls, pairs, motion)
    covariance = _covariance(slam.slam_state.mapper, map_1.walls, pairs[:, 0], points[:, 0])
    covariance += _covariance(other.slam_state.mapper, map_2.walls, pairs[:, 1], points[:, 1])

    def difference(change: Floats) -> Floats:
        return _differences(map_1.walls, map_2.walls, pairs, points, se2.compose(motion, change)).ravel()

    return _judge(difference(np.zeros(3)), _numerical_jacobian(difference), covariance)


def _judge(differences: Floats, jacobian: Floats, covariance: Floats) -> MapComparison:
    """Return the NEES of `differences` (2 n,) after least squares over the motion between the maps."""
    weighted = np.linalg.solve(covariance, jacobian)
    normal = jacobian.T @ weighted
    rest = differences - jacobian @ np.linalg.solve(normal, weighted.T @ differences)
    count = len(differences) // 2
    nees = float(rest @ np.linalg.solve(covariance, rest)) / (len(differences) - 3)
    remaining = covariance - jacobian @ np.linalg.solve(normal, jacobian.T)  # of the differences after the alignment
    blocks = [slice(2 * k, 2 * k + 2) for k in range(count)]
    single = np.array([rest[b] @ np.linalg.solve(remaining[b, b], rest[b]) for b in blocks])
    gross = float(np.mean(single > chi_square_quantile(GROSS, 2)))
    median = float(np.median(single)) / chi_square_quantile(0.5, 2)
    return MapComparison(count, nees, median, gross)


def align_maps(first: MapWalls, second: MapWalls, motion: se2.Pose) -> tuple[se2.Pose, Integers]:
    """Return the pose of the second map in the first one, and the rows (n, 2) of their common walls.

    `motion` is a first guess. Pairs are matched by position, and the motion is estimated by robust least squares with
    equal weights, whatever the covariances state.
    """
    pairs = np.zeros((0, 2), dtype=np.int64)
    for across, turn in GATES:
        pairs = _common_walls(first, second, motion, across, math.radians(turn))
        if len(pairs) < MIN_COMMON:
            return motion, pairs
        points = _shared_points(first, second, pairs, motion)
        for _ in range(ALIGNMENT_STEPS):
            motion = se2.compose(motion, _alignment_step(first, second, pairs, points, motion))
    return motion, pairs


def _alignment_step(first: MapWalls, second: MapWalls, pairs: Integers, points: Floats, motion: se2.Pose) -> se2.Pose:
    """Return the change of the motion by one step of iteratively reweighted least squares."""

    def scaled(change: Floats) -> Floats:
        differences = _differences(first, second, pairs, points, se2.compose(motion, change))
        return np.asarray((differences / ALIGNMENT_SIGMAS).ravel())

    values, jacobian = scaled(np.zeros(3)), _numerical_jacobian(scaled)
    root_weight = 1.0 / np.sqrt(1.0 + values**2)
    solution = np.linalg.lstsq(root_weight[:, None] * jacobian, -root_weight * values, rcond=None)
    return np.asarray(solution[0], dtype=np.float64)


def _common_walls(first: MapWalls, second: MapWalls, motion: se2.Pose, across: float, turn: float) -> Integers:
    """Return the rows (n, 2) of walls that can be the same: mutually nearest, and within the gates."""
    frames = se2.compose(motion, second.frame)
    ends = np.stack([second.low, second.high], axis=1)
    relative = se2.between(first.frame[:, None], frames[None])  # (first, second, 3)
    along = relative[..., 0, None] + np.cos(relative[..., 2, None]) * ends[None]
    low = np.maximum(along.min(axis=-1), first.low[:, None])
    high = np.minimum(along.max(axis=-1), first.high[:, None])
    middle = 0.5 * (low + high)
    offset = np.abs(relative[..., 1] + (middle - relative[..., 0]) * np.tan(relative[..., 2]))
    possible = (high - low > MIN_SHARED) & (np.abs(relative[..., 2]) < turn) & (offset < across)
    offset = np.where(possible, offset, np.inf)
    if not offset.size:
        return np.zeros((0, 2), dtype=np.int64)
    nearest, back = offset.argmin(axis=1), offset.argmin(axis=0)
    rows = np.flatnonzero(possible.any(axis=1))
    rows = rows[back[nearest[rows]] == rows]
    return np.column_stack([rows, nearest[rows]]).astype(np.int64)


def _shared_points(first: MapWalls, second: MapWalls, pairs: Integers, motion: se2.Pose) -> Floats:
    """Return the position (n, 2) along each wall of a pair, from its frame, of the middle of their common part."""
    one, two = pairs.T
    relative = se2.between(first.frame[one], se2.compose(motion, second.frame[two]))
    low = np.maximum(relative[:, 0] + second.low[two], first.low[one])
    high = np.minimum(relative[:, 0] + second.high[two], first.high[one])
    middle = 0.5 * (low + high)
    return np.column_stack([middle, middle - relative[:, 0]])


def _differences(first: MapWalls, second: MapWalls, pairs: Integers, points: Floats, motion: se2.Pose) -> Floats:
    """Return the offset across and the heading (n, 2) of the second map's walls relative to the first's.

    The offset is that at `points`, as from `_shared_points`; the second map is at `motion` in the first.
    """
    one, two = pairs.T
    zero = np.zeros(len(pairs))
    here = se2.compose(first.frame[one], np.column_stack([points[:, 0], zero, zero]))
    there = se2.compose(motion, se2.compose(second.frame[two], np.column_stack([points[:, 1], zero, zero])))
    relative = se2.between(here, there)
    return np.column_stack([relative[:, 1] - relative[:, 0] * np.tan(relative[:, 2]), relative[:, 2]])


def _covariance(mapper: Mapper, walls: MapWalls, rows: Integers, points: Floats) -> Floats:
    """Return the joint covariance (2 n, 2 n) of offset and heading of walls, each `points` (n,) metres along it."""
    joint = mapper.graph.wall_covariances([[int(walls.identity[row]) for row in rows]])[0]
    lever = np.eye(len(joint))
    lever[np.arange(0, len(joint), 2), np.arange(1, len(joint), 2)] = points
    return np.asarray(lever @ joint @ lever.T)


def _numerical_jacobian(function: Callable[[Floats], Floats]) -> Floats:
    """Return the derivative (m, 3) of a function of a small motion at zero, by central differences."""
    step = 1e-5
    columns = [(function(step * axis) - function(-step * axis)) / (2.0 * step) for axis in np.eye(3)]
    return np.column_stack(columns)

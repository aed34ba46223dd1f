"""Compare the walls that two maps of one building have in common with the joint covariances of both maps.

The maps are made from independent measurements. Their common walls should differ by what the covariances state, except
for the motion between the two maps' frames, which is estimated. Pairs of walls are found by position alone: if the
covariances influenced the selection, the NEES would be biased.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers import se2

from ...events import Finished
from ...geometry.chi_square import chi_square_quantile
from ...geometry.segments import Floats, Integers
from ...graph.graph_estimate import GraphEstimate
from ...io.tum import Trajectory
from ...offline.wall_alignment import MIN_COMMON, align_maps, numerical_jacobian, shared_points, wall_differences
from ...pipeline import Slam
from ..nees import GROSS


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
    starts = path.at([finished.keyframes.stamps[0] for _, finished in (first, second)]).poses
    motion, pairs = align_maps(map_1.walls, map_2.walls, se2.between(starts[0], starts[1]))
    if len(pairs) < MIN_COMMON:
        return None
    points = shared_points(map_1.walls, map_2.walls, pairs, motion)
    graphs = slam.slam_state.mapper.graph, other.slam_state.mapper.graph
    walls = map_1.walls.identity[pairs[:, 0]], map_2.walls.identity[pairs[:, 1]]
    covariance = _bends(graphs, walls, points)
    for graph, own, along in zip(graphs, walls, points.T, strict=True):
        covariance += _covariance(graph, own, along)

    def difference(change: Floats) -> Floats:
        return wall_differences(map_1.walls, map_2.walls, pairs, points, se2.compose(motion, change)).ravel()

    return _judge(difference(np.zeros(3)), numerical_jacobian(difference), covariance)


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


def _covariance(graph: GraphEstimate, walls: Integers, points: Floats) -> Floats:
    """Return the joint covariance (2 n, 2 n) of offset and heading of walls (n,), as if they were straight.

    points  (n,) metres along each wall from its frame, where the offset is that of its line
    """
    joint = graph.covariance_of([], walls.tolist())
    rows = np.flatnonzero(np.arange(len(joint)) % 3)  # offset and heading of (along, offset, heading)
    joint, lever = joint[np.ix_(rows, rows)], np.eye(len(rows))
    lever[np.arange(0, len(joint), 2), np.arange(1, len(joint), 2)] = points
    return np.asarray(lever @ joint @ lever.T)


def _bends(graphs: tuple[GraphEstimate, GraphEstimate], walls: tuple[Integers, Integers], points: Floats) -> Floats:
    """Return the joint covariance (2 n, 2 n) of the differences of walls that bends cause.

    walls   (n,) of each map
    points  (n, 2) metres along the walls of each pair

    Both maps show the same bends of a wall, so lines differ only as far as other parts of the wall were seen.
    """
    bends = [graph.wall_bends for graph in graphs]
    variance, length = 0.5 * sum(one.sigma**2 for one in bends), 0.5 * sum(one.length for one in bends)
    joint = np.zeros((2 * len(points), 2 * len(points)))
    for row, (pair, along) in enumerate(zip(zip(*walls, strict=True), points, strict=True)):
        one, two = (own.responses.get(int(wall)) for own, wall in zip(bends, pair, strict=True))
        if one is not None and two is not None:
            difference = one.at(along[0]).minus(two.at(along[1]))
            joint[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] = difference.covariance(variance, length)
    return joint

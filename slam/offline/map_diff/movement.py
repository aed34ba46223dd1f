"""Which of the walls that two maps have in common have moved.

The differences d of all pairs, offset and heading, have the covariance C = C_old + C_new, the sum of the joint ones of
both maps. The motion m between the maps' frames is estimated from the pairs that have not moved by generalised least
squares. The remaining differences r = A d, with A = 1 - J G for m = G d, have the covariance A C A'. A pair has moved
if r' (A C A')^-1 r of its own two components is significant; then it is left out of the estimate of m, until nothing
changes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable

from ...geometry.normal_distribution import PLANE_MEDIAN
from ...geometry.segments import Floats, Integers
from ...measuring.wall_map import WallGeometry
from ..wall_alignment import numerical_jacobian, shared_points, wall_differences

# Probability beyond which a pair is left out of the alignment. Origin: chosen, one of a thousand; not measured.
OUTLIER_PROBABILITY = 1e-3
# Iterations for the pairs that have not moved. Origin: numerical.
MAX_ITERATIONS = 10


@immutable
class Movements:
    """Movements of n pairs of walls.

    pairs     (n, 2) rows of the walls: old, new
    shift     (n,) metres by which the new wall is farther on the left of the old one, where both were seen
    turn      (n,) radians by which it is turned
    sigma     (n, 2) standard deviations of both
    p_value   (n,) probability of such a difference or a larger one if the wall has not moved
    motion    (3,) pose of the new map in the old one
    scale     factor of all variances: 1, or more if the typical difference is larger than stated
    points    (n, 2) metres along both walls, from their frames, of the middle of their common part
    gain      (3, 2 n) of the motion by the differences of offset, there, and heading of all pairs
    """

    pairs: Integers
    shift: Floats
    turn: Floats
    sigma: Floats
    p_value: Floats
    motion: se2.Pose
    scale: float
    points: Floats
    gain: Floats


def find_movements(
    old: WallGeometry, new: WallGeometry, pairs: Integers, motion: se2.Pose, unmoved: NDArray[np.bool_] | None = None
) -> Movements:
    """Return the movements of pairs (n, 2) of walls.

    motion   guess of the pose of the new map in the old one
    unmoved  (n,) pairs that are known not to have moved, if any are known; if None, they are found by iteration
    """
    points = shared_points(old.walls, new.walls, pairs, motion)
    covariance = _at_points(old, pairs[:, 0], points[:, 0]) + _at_points(new, pairs[:, 1], points[:, 1])
    still = np.ones(len(pairs), dtype=bool) if unmoved is None else unmoved
    for _ in range(MAX_ITERATIONS):

        def differences(change: Floats, motion: se2.Pose = motion) -> Floats:
            return wall_differences(old.walls, new.walls, pairs, points, se2.compose(motion, change)).ravel()

        values, jacobian = differences(np.zeros(3)), numerical_jacobian(differences)
        used = np.flatnonzero(np.repeat(still, 2))
        weighted = np.linalg.solve(covariance[np.ix_(used, used)], jacobian[used])
        gain = np.zeros((3, len(values)))
        gain[:, used] = np.linalg.solve(jacobian[used].T @ weighted, weighted.T)
        projection = np.eye(len(values)) - jacobian @ gain
        rest, remaining = projection @ values, projection @ covariance @ projection.T
        squared, sigma = _squared(rest, remaining)
        scale = max(float(np.median(squared[still])) / PLANE_MEDIAN, 1.0)
        p_value = np.exp(-0.5 * squared / scale)
        motion = se2.compose(motion, -gain @ values)
        now = p_value >= OUTLIER_PROBABILITY
        if unmoved is not None or (now == still).all() or 2 * now.sum() <= len(now):
            break
        still = now
    return Movements(pairs, rest[::2], rest[1::2], np.sqrt(scale) * sigma, p_value, motion, scale, points, gain)


def _squared(rest: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return the squared Mahalanobis distance (n,) and the standard deviations (n, 2) of each pair."""
    count = np.arange(len(rest) // 2)
    blocks = covariance.reshape(len(count), 2, len(count), 2)[count, :, count, :]
    pairs = rest.reshape(-1, 2)
    squared = np.einsum("ni,ni->n", pairs, np.linalg.solve(blocks, pairs[..., None])[..., 0])
    return squared, np.sqrt(np.einsum("nii->ni", blocks))


def _at_points(wall_map: WallGeometry, rows: Integers, points: Floats) -> Floats:
    """Return the joint covariance (2 n, 2 n) of offset and heading of walls (n,), each `points` (n,) metres along."""
    walls, own = np.unique(rows, return_inverse=True)  # few of the walls of a large plan
    by_walls = levers(len(walls), own, points)
    return np.asarray(by_walls @ wall_map.joint_covariance(walls) @ by_walls.T)


def levers(count: int, rows: Integers, points: Floats) -> Floats:
    """Return the derivatives (2 n, 2 m) of offset and heading of n walls, `points` metres along, by those of all m.

    count  number of walls, m
    """
    place = np.arange(len(rows))
    by_walls = np.zeros((2 * len(rows), 2 * count))
    by_walls[2 * place, 2 * rows] = 1.0
    by_walls[2 * place, 2 * rows + 1] = points
    by_walls[2 * place + 1, 2 * rows + 1] = 1.0
    return by_walls

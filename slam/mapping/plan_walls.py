"""Comparison of walls of the map with those of a plan, by a statistical test.

At the middle of what two walls have in common, the difference d of offset and heading has the covariance
C = C_map + C_plan if both are the same wall; it is refuted if d' C^-1 d is beyond the gate. If the plan has been used
for the wall already, the map follows it: then the covariance of the difference is C_plan - C_map, as of any residual of
least squares (Baarda 1968).
"""

from __future__ import annotations

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import MIN_WALL_LENGTH
from .data_association import ASSOCIATION_GATE
from .local_map import MAX_HEADING_DIFFERENCE, MAX_OFFSET, MAX_PREDICTED_TURN_VARIANCE, MAX_PREDICTED_VARIANCE
from .map_features import MapWalls

# Metres that two walls must have in common to be compared, or to be the same. Origin: definition.
MIN_COMMON_LENGTH = MIN_WALL_LENGTH
# Share of the covariance of a plan's wall below which the difference from it is certain to be small.
# Origin: numerical.
MIN_REST = 1e-3


@immutable
class PlanWall:
    """What a plan states about a wall of the map.

    wall        landmark id
    row         of the wall in the plan
    frame       (3,) on the plan's wall, nearest to the frame of the map's wall
    covariance  (2, 2) of offset and heading of the plan's wall there
    """

    wall: int
    row: int
    frame: se2.Pose
    covariance: Floats


def walls_on_plan(
    walls: Integers, frames: Floats, extents: Floats, covariances: Floats, plan: MapWalls
) -> list[PlanWall]:
    """Return what a plan states about those walls (n,) that it agrees with.

    frames       (n, 3) in the frame of the plan
    extents      (n, 2) begin and end along the frames
    covariances  (n, 2, 2) of offset and heading at the frames, relative to the plan
    """
    if not len(walls) or not len(plan):
        return []
    relative = se2.between(plan.frame[None], frames[:, None])  # (walls, plan, 3)
    along = relative[..., 0]
    low = np.maximum(along + extents[:, :1], plan.low[None])
    high = np.minimum(along + extents[:, 1:], plan.high[None])
    middle = 0.5 * (low + high)  # along the plan's wall
    offset = relative[..., 1] + (middle - along) * np.tan(relative[..., 2])
    own, of_plan = _at(covariances[:, None], middle - along), _at(plan.covariance[None], middle)
    difference = np.stack([offset, relative[..., 2]], axis=-1)
    squared = np.einsum("npi,npi->np", difference, np.linalg.solve(own + of_plan, difference[..., None])[..., 0])
    possible = (high - low >= MIN_COMMON_LENGTH) & (np.abs(relative[..., 2]) < MAX_HEADING_DIFFERENCE)
    possible &= (np.abs(offset) < MAX_OFFSET) & (squared < ASSOCIATION_GATE)
    possible &= (own[..., 0, 0] < MAX_PREDICTED_VARIANCE) & (own[..., 1, 1] < MAX_PREDICTED_TURN_VARIANCE)
    squared = np.where(possible, squared, np.inf)
    best = squared.argmin(axis=1)
    return [
        _stated(int(walls[k]), int(best[k]), float(along[k, best[k]]), plan)
        for k in np.flatnonzero(possible.any(axis=1)).tolist()
    ]


def contradicts(frame: se2.Pose, covariance: Floats, stated: se2.Pose, stated_covariance: Floats) -> bool:
    """Return True if a wall whose estimate includes a plan refutes it.

    frame, covariance            of the wall in the map: (3,), and (2, 2) of offset and heading
    stated, stated_covariance    the same of the plan's wall
    """
    rest = stated_covariance - covariance
    scale = np.sqrt(np.diag(stated_covariance))
    values, vectors = np.linalg.eigh(rest / np.outer(scale, scale))
    difference = vectors.T @ (se2.between(stated, frame)[1:] / scale)
    return bool((difference**2 / np.maximum(values, MIN_REST)).sum() > ASSOCIATION_GATE)


def _stated(wall: int, row: int, along: float, plan: MapWalls) -> PlanWall:
    """Return what a plan's wall states some metres along it."""
    frame = se2.compose(plan.frame[row], np.array([along, 0.0, 0.0]))
    return PlanWall(wall, row, frame, _at(plan.covariance[row], np.array(along)))


def _at(covariances: Floats, along: Floats) -> Floats:
    """Return covariances (..., 2, 2) of offset and heading at points some metres along the walls (...)."""
    result = np.broadcast_to(covariances, (*along.shape, 2, 2)).copy()
    result[..., 0, 0] += 2.0 * along * covariances[..., 0, 1] + along**2 * covariances[..., 1, 1]
    result[..., 0, 1] += along * covariances[..., 1, 1]
    result[..., 1, 0] = result[..., 0, 1]
    return result

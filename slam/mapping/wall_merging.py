"""Detection of walls that were mapped twice: two landmarks on one real wall.

While the robot drives, the walls of the local map are compared, with covariances relative to the robot. When the
estimate converges at the end, all walls of the map are compared with their joint covariances in the graph.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled

from ..geometry.angles import axes_of, wrap_angle
from ..geometry.chi_square import chi_square_quantile
from ..geometry.membership import is_among
from ..geometry.roughness import Roughness, add_roughness
from ..geometry.segments import Floats, Integers
from ..geometry.significance import STRICT_GATE
from ..geometry.surroundings import SURFACE_DEPTH
from ..graph.factor_graph import FactorGraph
from .keyframes import WallMerge
from .landmarks import Landmarks
from .local_map import MAX_HEADING_DIFFERENCE, MAX_PREDICTED_TURN_VARIANCE, MAX_PREDICTED_VARIANCE, LocalMap
from .unconfirmed_observations import CONFIRMING_KEYFRAMES
from .wall_cells import END_ERROR_CELLS, WALL_CELL

# Squared Mahalanobis distance between two walls that may be one. Stricter than the association gate, as a merge is
# final. Origin: chi-square, 2 dof.
MERGE_GATE = chi_square_quantile(STRICT_GATE, 2)
# Metres between two walls that may be one, in the middle of their overlap, however large their covariances.
# Origin: definition, walls and furniture are thicker.
MAX_MERGE_OFFSET = SURFACE_DEPTH
# Radians between two walls that may be one. Origin: definition, both are within it of one segment.
MAX_MERGE_HEADING = 0.5 * MAX_HEADING_DIFFERENCE
# Keyframes that must have observed a wall before it is merged by its covariance relative to the robot alone.
# Origin: chosen, one more than for confirmation; not measured.
MIN_OBSERVATIONS_TO_MERGE = CONFIRMING_KEYFRAMES + 1


@dataclass(frozen=True, slots=True)
class Overlap:
    """Two walls, given by their rows `first` and `second`, that run alongside each other.

    along   metres along the first wall at which the second's frame is
    middle  metres along the first wall of the middle of the overlap
    length  metres of overlap
    offset  metres from the first wall to the second, in the middle
    turn    radians from the first wall to the second
    """

    first: int
    second: int
    along: float
    middle: float
    length: float
    offset: float
    turn: float

    def distance(self, covariance: Floats, roughness: Roughness) -> float:
        """Return the squared Mahalanobis distance between the two walls.

        `covariance` (2, 2) is that of offset and turn; the wall roughness is added to it.
        """
        difference = np.array([self.offset, self.turn])
        (whole,) = add_roughness(covariance[None], np.array([0.5 * self.length]), roughness)
        return float(difference @ np.linalg.solve(whole, difference))


def find_duplicate_wall(
    local_map: LocalMap, mature: NDArray[np.bool_], observed: NDArray[np.bool_], roughness: Roughness
) -> WallMerge | None:
    """Return the pair of walls of the local map that are one with the smallest distance; None if there is none.

    mature     (n,) which walls have been observed often enough; both walls of a pair must be mature
    observed   (n,) which walls were observed just now; at least one wall of a pair must be
    roughness  of the walls

    Walls are compared in the middle of their overlap, with covariances relative to the robot, so the uncertainty of the
    robot's own pose has no influence.
    """
    rows = np.flatnonzero(mature)
    if len(rows) < 2:
        return None
    pairs = find_overlaps(local_map.frame[rows], local_map.low[rows], local_map.high[rows])
    best: WallMerge | None = None
    for pair in pairs:
        first, second = int(rows[pair.first]), int(rows[pair.second])
        if not (observed[first] or observed[second]):
            continue
        at_first = _covariance_along(local_map.wall_covariance[first], pair.middle)
        at_second = _covariance_along(local_map.wall_covariance[second], pair.middle - pair.along)
        distance = pair.distance(at_first + at_second, roughness)
        if distance < MERGE_GATE and (best is None or distance < best.distance):
            best = WallMerge(int(local_map.walls[first]), int(local_map.walls[second]), distance)
    return best


def find_observed_duplicate(
    landmarks: Landmarks, local_map: LocalMap, observed_walls: Integers, roughness: Roughness
) -> WallMerge | None:
    """Return the most certain pair of duplicate walls of the local map of which one was just observed, if any.

    `observed_walls` are the ids of those observed just now, `roughness` as in `find_duplicate_wall`.
    """
    rows = landmarks.walls.rows[local_map.walls]
    mature = rows["in_graph"] & (rows["observations"] >= MIN_OBSERVATIONS_TO_MERGE)
    observed = is_among(local_map.walls, observed_walls)
    return find_duplicate_wall(local_map, mature, observed, roughness)


def merge_duplicate_walls(
    landmarks: Landmarks, graph: FactorGraph, roughness: Roughness, merge: Callable[[int, int], None]
) -> int:
    """Call `merge(kept, absorbed)` for each pair of duplicate walls, smallest distance first; return their number.

    All confirmed walls of connected parts of the map are compared, with their joint covariances in `graph`.
    `roughness` is that of the walls.
    """
    walls = landmarks.walls.rows
    rows = np.flatnonzero(walls["in_graph"] & landmarks.active())
    overlaps = find_overlaps(walls["frame"][rows], walls["low"][rows], walls["high"][rows])
    group = landmarks.parts.groups_of(walls["last_seen"][rows])
    overlaps = [pair for pair in overlaps if group[pair.first] == group[pair.second]]
    pairs = [[int(rows[pair.first]), int(rows[pair.second])] for pair in overlaps]
    found = []
    for pair, (first, second), joint in zip(overlaps, pairs, graph.wall_covariances(pairs), strict=True):
        covariance = _relative_covariance(joint, pair)
        comparable = covariance[0, 0] < MAX_PREDICTED_VARIANCE and covariance[1, 1] < MAX_PREDICTED_TURN_VARIANCE
        distance = pair.distance(covariance, roughness)
        if comparable and distance < MERGE_GATE:
            found.append((distance, first, second))
    merged = 0
    for _, first, second in sorted(found):
        if walls["merged_into"][first] == first and walls["merged_into"][second] == second:
            merge(first, second)
            merged += 1
    return merged


def find_overlaps(frame: Floats, low: Floats, high: Floats) -> list[Overlap]:
    """Return all pairs of walls that run alongside each other, close, facing the same side and nearly parallel.

    The walls have frames (n, 3) and extend from `low` to `high` (n,) metres along them.
    """
    pairs, values = _overlaps(frame, low, high)
    return [Overlap(*pair, *row) for pair, row in zip(pairs.tolist(), values.tolist(), strict=True)]


@compiled
def _overlaps(frame, low, high):  # type: ignore[no-untyped-def]
    """Return (m, 2) the pairs of `find_overlaps`, and (m, 5) along, middle, length, offset and turn of each."""
    most = len(frame) * (len(frame) - 1) // 2
    pairs, values, count, axes = np.empty((most, 2), np.int64), np.empty((most, 5)), 0, axes_of(frame)
    for i in range(len(frame)):
        for j in range(i + 1, len(frame)):
            turn = wrap_angle(frame[j, 2] - frame[i, 2])
            if not abs(turn) < MAX_MERGE_HEADING:
                continue
            dx, dy, (c, s) = frame[j, 0] - frame[i, 0], frame[j, 1] - frame[i, 1], axes[i]
            along, across = c * dx + s * dy, c * dy - s * dx  # the second wall's frame in the first's
            start, end = max(low[i], along + low[j]), min(high[i], along + high[j])
            middle = 0.5 * (start + end)
            offset = across + (middle - along) * math.tan(turn)
            if abs(offset) < MAX_MERGE_OFFSET and end - start > END_ERROR_CELLS * WALL_CELL:
                pairs[count, 0], pairs[count, 1] = i, j
                values[count, 0], values[count, 1], values[count, 2] = along, middle, end - start
                values[count, 3], values[count, 4] = offset, turn
                count += 1
    return pairs[:count], values[:count]


def _covariance_along(covariance: Floats, along: float) -> Floats:
    """Return the covariance (2, 2) of offset and heading `along` metres from the frame, given that at the frame."""
    jacobian = np.array([[1.0, along], [0.0, 1.0]])
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _relative_covariance(joint: Floats, pair: Overlap) -> Floats:
    """Return the covariance (2, 2) of offset and turn between two walls in the middle of their overlap.

    `joint` (4, 4) is the joint covariance of offset and heading of the first and the second wall, at their frames.
    """
    jacobian = np.array([[-1.0, -pair.middle, 1.0, pair.middle - pair.along], [0.0, -1.0, 0.0, 1.0]])
    return np.asarray(jacobian @ joint @ jacobian.T)

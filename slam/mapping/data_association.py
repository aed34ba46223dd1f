"""Data association: decide which landmark each feature of a keyframe belongs to.

Features are assigned greedily to the landmark with the smallest Mahalanobis distance, with propagated covariances, less
a bonus for landmarks with many observations. A landmark gets one feature of a scan; a wall also gets several segments
that do not overlap along it, as when it is partly hidden by an obstacle.
"""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined
from drivers.immutable import immutable
from drivers.small_matrices import bilinear_form, mahalanobis_squared, quadratic_form

from ..geometry.angles import wrap_angle
from ..geometry.chi_square import chi_square_quantile
from ..geometry.roughness import Roughness
from ..geometry.segments import CornerPoints, Floats, Integers, Segments
from ..geometry.significance import GATE
from ..geometry.surroundings import DOOR_WIDTH
from .local_map import (
    MAX_HEADING_DIFFERENCE,
    MAX_OFFSET,
    MAX_PREDICTED_TURN_VARIANCE,
    MAX_PREDICTED_VARIANCE,
    LocalMap,
)
from .wall_cells import ON_WALL_DISTANCE, WALL_CELL

# Squared Mahalanobis distance between a feature and its landmark. Origin: chi-square, 2 dof.
ASSOCIATION_GATE = chi_square_quantile(GATE, 2)
# Metres between the known extent of a wall and a segment that continues it. Origin: definition, a door.
MAX_GAP = DOOR_WIDTH
# Metres by which two segments of one wall may overlap in one scan, by errors of their ends.
# Origin: chosen, one cell of coverage; not measured.
MAX_OVERLAP_IN_SCAN = WALL_CELL
# Metres: a segment this close to a wall, but outside the gate, is ambiguous: neither this wall nor a new
# one. Origin: chosen; not measured.
AMBIGUOUS_OFFSET = 0.12
# Radians, likewise. Origin: chosen; not measured.
AMBIGUOUS_HEADING = math.radians(6.0)
# Radians between the walls at an observed corner and those of its landmark. Origin: chosen, twice the widest heading
# gate of segments; not measured.
MAX_CORNER_HEADING_DIFFERENCE = math.radians(20.0)
# Metres: a corner this close to a known one, but outside the gate, is ambiguous. Origin: definition, walls end so near
# to it.
AMBIGUOUS_CORNER = ON_WALL_DISTANCE
# Values in place of a row of the local map. Origin: definition.
UNMATCHED, AMBIGUOUS = -1, -2


@immutable
class RowAssociation:
    """Landmarks associated with the segments (n,) and corners (m,) of a scan, as rows of the local map.

    walls, corners                   row, UNMATCHED for a new landmark, or AMBIGUOUS: too close to a landmark to be new
    nearest_wall, nearest_corner     row of the nearest candidate, matched or not; -1 without one
    wall_distance, corner_distance   squared Mahalanobis distance to the nearest candidate; NaN without one
    """

    walls: Integers
    wall_distance: Floats
    nearest_wall: Integers
    corners: Integers
    corner_distance: Floats
    nearest_corner: Integers

    def in_landmark_ids(self, walls: Integers, corners: Integers, local_map: LocalMap) -> LandmarkAssociation:
        """Return the same association with landmark ids instead of rows of the local map.

        `walls` (n,) and `corners` (m,) are the ids assigned to the features, -1 for none.
        """
        return LandmarkAssociation(
            walls,
            self.wall_distance,
            _ids_of(self.nearest_wall, local_map.walls),
            corners,
            self.corner_distance,
            _ids_of(self.nearest_corner, local_map.corners),
        )


@immutable
class LandmarkAssociation:
    """Landmarks associated with the segments (n,) and corners (m,) of a keyframe, as landmark ids.

    walls, corners                   id, also of landmarks that the keyframe has added; -1 for a feature of none
    nearest_wall, nearest_corner     id of the nearest candidate, matched or not; -1 without one
    wall_distance, corner_distance   squared Mahalanobis distance to the nearest candidate; NaN without one
    """

    walls: Integers
    wall_distance: Floats
    nearest_wall: Integers
    corners: Integers
    corner_distance: Floats
    nearest_corner: Integers


def associate(
    pose: se2.Pose,
    covariance: Floats,
    segments: Segments,
    corners: CornerPoints,
    local_map: LocalMap,
    roughness: Roughness,
) -> RowAssociation:
    """Associate the features of a scan with the landmarks of the local map.

    pose        of the base in the map, with its `covariance` (3, 3) in the base's frame
    roughness   of the walls
    """
    distance, low, high = _wall_distances(
        pose, covariance, segments.frame, segments.half_length, segments.covariance,
        local_map.frame, local_map.low, local_map.high, local_map.wall_covariance, tuple(roughness),
    )  # fmt: skip
    walls, wall_distance, nearest_wall = _assign_greedily(distance, local_map.observations, low, high)
    corner_distance = _corner_distances(
        pose, covariance, corners.position, corners.headings, corners.covariance,
        local_map.position, local_map.headings, local_map.corner_covariance, roughness.offset,
    )  # fmt: skip
    no_extent, equal = np.zeros_like(corner_distance), np.ones(len(local_map.corners), dtype=np.int64)
    rows, smallest, nearest = _assign_greedily(corner_distance, equal, no_extent, no_extent)
    return RowAssociation(walls, wall_distance, nearest_wall, rows, smallest, nearest)


def _ids_of(rows: Integers, landmarks: Integers) -> Integers:
    """Return the landmark ids of rows of the local map, -1 for row -1."""
    return np.where(rows >= 0, landmarks[rows], -1) if len(landmarks) else np.full(len(rows), -1)


@compiled
def _assign_greedily(distance, observations, low, high):  # type: ignore[no-untyped-def]
    """Assign n features to m landmarks, the pair with the smallest cost first.

    distance      (n, m) squared Mahalanobis distances; only pairs within the gate are assigned
    observations  (m,) of each landmark. Its prior probability is proportional to them, so the cost of a pair is its
                  distance minus twice their logarithm. With equal priors, two landmarks on one wall would share its
                  observations by the sign of their error, and each share would confirm that they are two
    low, high     (n, m) extent of the feature along the landmark: further features must not overlap with it

    Returns three arrays (n,): the column of the landmark that each feature is assigned to, the distance to the nearest
    landmark, and the column of that; NaN and -1 without one. A feature that is not assigned is AMBIGUOUS if any of its
    distances is finite, else UNMATCHED.
    """
    features, landmarks = distance.shape
    columns, nearest = np.full(features, UNMATCHED), np.full(features, -1)
    smallest = np.full(features, np.nan)
    pairs, costs, count = np.empty(features * landmarks, np.int64), np.empty(features * landmarks), 0
    for i in range(features):
        for j in range(landmarks):
            if not np.isfinite(distance[i, j]):
                continue
            columns[i] = AMBIGUOUS
            if nearest[i] < 0 or distance[i, j] < smallest[i]:
                smallest[i], nearest[i] = distance[i, j], j
            if distance[i, j] < ASSOCIATION_GATE:
                cost = distance[i, j] - 2.0 * math.log(max(observations[j], 1))
                _insert_sorted(pairs, costs, count, i * landmarks + j, cost)
                count += 1
    for pair in pairs[:count]:
        i, j = divmod(pair, landmarks)
        if columns[i] >= 0:
            continue
        fits = True
        for other in range(features):
            if columns[other] == j:
                overlap = min(high[i, j], high[other, j]) - max(low[i, j], low[other, j])
                fits = fits and overlap < MAX_OVERLAP_IN_SCAN and high[i, j] > low[i, j]
        if fits:
            columns[i] = j
    return columns, smallest, nearest


@inlined
def _insert_sorted(pairs, costs, count, pair, cost):  # type: ignore[no-untyped-def]
    """Insert a pair after all that do not cost more, into the first `count` pairs, which are sorted by their costs.

    The pairs of a scan are few, and NumPy's sort takes long to compile.
    """
    place = count
    while place > 0 and costs[place - 1] > cost:
        pairs[place], costs[place] = pairs[place - 1], costs[place - 1]
        place -= 1
    pairs[place], costs[place] = pair, cost


@compiled
def _wall_distances(  # type: ignore[no-untyped-def]
    pose, pose_covariance, frames, halves, covariances, walls, lows, highs, wall_covariances, roughness
):
    """Return (n, m) squared Mahalanobis distances, infinite for excluded pairs, and both ends along the wall."""
    shape = (len(frames), len(walls))
    distance, low, high = np.full(shape, np.inf), np.zeros(shape), np.zeros(shape)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(len(frames)):
        lever_x = c * frames[i, 0] - s * frames[i, 1]
        lever_y = s * frames[i, 0] + c * frames[i, 1]
        for j in range(len(walls)):
            turn = wrap_angle(pose[2] + frames[i, 2] - walls[j, 2])
            if abs(turn) > MAX_HEADING_DIFFERENCE:
                continue
            wc, ws = math.cos(walls[j, 2]), math.sin(walls[j, 2])
            dx, dy = pose[0] + lever_x - walls[j, 0], pose[1] + lever_y - walls[j, 1]
            along, offset = wc * dx + ws * dy, -ws * dx + wc * dy
            gap = max(along - halves[i] - highs[j], lows[j] - along - halves[i])
            if abs(offset) > MAX_OFFSET or gap > MAX_GAP:
                continue
            # derivatives of the offset by the pose
            by_x, by_y, by_turn = -ws * c + wc * s, ws * s + wc * c, ws * lever_y + wc * lever_x
            wall = wall_covariances[j]
            across = quadratic_form(pose_covariance, by_x, by_y, by_turn)
            across += wall[0, 0] + 2 * along * wall[0, 1] + along * along * wall[1, 1]
            heading = pose_covariance[2, 2] + wall[1, 1]
            if across > MAX_PREDICTED_VARIANCE or heading > MAX_PREDICTED_TURN_VARIANCE:
                continue
            mixed = by_x * pose_covariance[0, 2] + by_y * pose_covariance[1, 2] + by_turn * pose_covariance[2, 2]
            mixed += wall[0, 1] + along * wall[1, 1] + covariances[i, 0, 1]
            across += covariances[i, 0, 0] + roughness[0]
            heading += covariances[i, 1, 1] + 3 * roughness[1] / halves[i] ** 2
            chi2 = mahalanobis_squared(across, mixed, heading, offset, turn)
            close = abs(offset) < AMBIGUOUS_OFFSET and abs(turn) < AMBIGUOUS_HEADING and gap < 0.0
            if chi2 < ASSOCIATION_GATE or close:
                distance[i, j], low[i, j], high[i, j] = chi2, along - halves[i], along + halves[i]
    return distance, low, high


@compiled
def _corner_distances(  # type: ignore[no-untyped-def]
    pose, pose_covariance, points, headings, covariances, corners, corner_headings, corner_covariances, roughness
):
    """Return (n, m) squared Mahalanobis distances, infinite for excluded pairs."""
    distance = np.full((len(points), len(corners)), np.inf)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(len(points)):
        lever_x, lever_y = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        # covariance of the position by that of the pose, and that of the corner in the scan
        xx = quadratic_form(pose_covariance, c, -s, -lever_y)
        xy = bilinear_form(pose_covariance, c, -s, -lever_y, s, c, lever_x)
        yy = quadratic_form(pose_covariance, s, c, lever_x)
        own, along, mixed, across = covariances[i], c * c, c * s, s * s
        own_xx = along * own[0, 0] - 2.0 * mixed * own[0, 1] + across * own[1, 1]
        own_xy = mixed * (own[0, 0] - own[1, 1]) + (along - across) * own[0, 1]
        own_yy = across * own[0, 0] + 2.0 * mixed * own[0, 1] + along * own[1, 1]
        for j in range(len(corners)):
            x, y = pose[0] + lever_x - corners[j, 0], pose[1] + lever_y - corners[j, 1]
            if max(abs(x), abs(y)) > MAX_OFFSET:
                continue
            if abs(wrap_angle(pose[2] + headings[i, 0] - corner_headings[j, 0])) > MAX_CORNER_HEADING_DIFFERENCE:
                continue
            if abs(wrap_angle(pose[2] + headings[i, 1] - corner_headings[j, 1])) > MAX_CORNER_HEADING_DIFFERENCE:
                continue
            known_xx, known_yy = xx + corner_covariances[j, 0, 0], yy + corner_covariances[j, 1, 1]
            if max(known_xx, known_yy) > MAX_PREDICTED_VARIANCE:
                continue
            known_xy = xy + corner_covariances[j, 0, 1]
            chi2 = mahalanobis_squared(
                known_xx + own_xx + roughness, known_xy + own_xy, known_yy + own_yy + roughness, x, y
            )
            if chi2 < ASSOCIATION_GATE or math.hypot(x, y) < AMBIGUOUS_CORNER:
                distance[i, j] = chi2
    return distance

"""Distance field: the vector from the nearest scan point to each cell of a grid, and which cells were seen.

A scan is matched to it with all its points, whatever they belong to. Points are inserted one scan at a time, so the
field grows with the drive; it is rebuilt when the robot leaves its middle or when the map is corrected.

A wall has two faces some centimetres apart, and a robot that drives past it sees first one and then the other. To match
one with the other would shift the pose by the wall's thickness. So there is one grid for each direction that a surface
faces, and one for all points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import Floats

# Metres, side of a cell. Origin: chosen, the noise of usual lidars; distances are interpolated between cells.
FIELD_CELL = 0.05
# Metres from the middle to each side. Origin: chosen, the range of usual indoor lidars; farther points are not used.
FIELD_HALF_WIDTH = 30.0
# Metres: larger distances are not stored. It is also how far a pose may be off for Gauss-Newton to correct it.
# Origin: chosen, about the width of a corridor's furniture; not measured.
MAX_DISTANCE = 0.5
# Metres, side of the cells in which it is stored whether a beam crossed them. Origin: chosen; not measured.
SEEN_CELL = 0.25
# Metres. Origin: numerical, 16 bits hold more than MAX_DISTANCE with it.
OFFSET_UNIT = 1e-4
# Offset where there is no point. Origin: numerical, the largest number of 16 bits.
NOWHERE = 32767
# Cosine between a surface's normal and a direction up to which the surface belongs to it. Origin: definition, 67.5
# degrees: a surface belongs to the nearest of the four directions, and to the second one if it is nearly as near.
MIN_FACING = math.cos(math.radians(67.5))
# Number of the grid of all points, after those of surfaces that face along x, y, -x and -y. Origin: definition.
ALL_POINTS = 4
# Metres from an inserted point within which another point adds nothing. Origin: definition, half a cell's diagonal.
SAME_POINT = FIELD_CELL / math.sqrt(2.0)


@dataclass(frozen=True, slots=True, eq=False)
class DistanceField:
    """Square grids; row and column of a point are floor((xy - origin) / FIELD_CELL), or SEEN_CELL.

    origin  (2,) corner of the grids in the map, metres
    offset  (5, c, c, 2) from the nearest point to the cell's centre in units of OFFSET_UNIT, NOWHERE if there is none
            within MAX_DISTANCE: of surfaces that face along x, y, -x, -y, and of all points
    seen    (s, s) 1 if a beam crossed the cell or ended in it
    """

    origin: Floats
    offset: NDArray[np.int16]
    seen: NDArray[np.uint8]

    @classmethod
    def empty(cls, centre: Floats, half_width: float = FIELD_HALF_WIDTH) -> DistanceField:
        """Return a field around `centre` (2,) without points."""
        origin = np.floor((np.asarray(centre[:2]) - half_width) / SEEN_CELL) * SEEN_CELL
        cells, coarse = int(2 * half_width / FIELD_CELL), int(2 * half_width / SEEN_CELL)
        return cls(
            origin,
            np.full((ALL_POINTS + 1, cells, cells, 2), NOWHERE, dtype=np.int16),
            np.zeros((coarse, coarse), dtype=np.uint8),
        )

    def insert(self, pose: se2.Pose, points: Floats) -> None:
        """Insert a scan's points (p, 4) with normals that face the lidar, given in the frame of the base at `pose`.

        A point whose normal is zero, or not given (p, 2), may face in any direction. Points outside the field only mark
        the cells that their beams cross as seen.
        """
        if points.shape[1] == 2:
            points = np.column_stack([points, np.zeros_like(points)])
        _insert(self.offset, self.seen, self.origin, np.asarray(pose, dtype=np.float64), points)

    @property
    def centre(self) -> Floats:
        """Middle of the field (2,), metres."""
        return np.asarray(self.origin + 0.5 * self.offset.shape[1] * FIELD_CELL)

    def centre_distance(self, position: Floats) -> float:
        """Return the larger distance (metres) along the axes of a position (2,) from the middle of the field."""
        return float(np.abs(position[:2] - self.centre).max())


@compiled
def _insert(offset, seen, origin, pose, points):  # type: ignore[no-untyped-def]
    """Enter the offsets from each point into the cells around it, and mark the cells between it and the robot."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    start_x, start_y = pose[0] - origin[0], pose[1] - origin[1]
    for k in range(len(points)):
        end_x = start_x + c * points[k, 0] - s * points[k, 1]
        end_y = start_y + s * points[k, 0] + c * points[k, 1]
        _mark_seen(seen, start_x / SEEN_CELL, start_y / SEEN_CELL, end_x / SEEN_CELL, end_y / SEEN_CELL)
        x, y = end_x / FIELD_CELL, end_y / FIELD_CELL
        _insert_point(offset[ALL_POINTS], x, y)
        normal_x, normal_y = c * points[k, 2] - s * points[k, 3], s * points[k, 2] + c * points[k, 3]
        unknown = normal_x == 0.0 and normal_y == 0.0
        for grid in range(ALL_POINTS):
            along = normal_x if grid % 2 == 0 else normal_y
            if unknown or (along if grid < 2 else -along) > MIN_FACING:
                _insert_point(offset[grid], x, y)


@compiled
def _insert_point(offset, x, y):  # type: ignore[no-untyped-def]
    """Enter the offsets from a point at (x, y), in cells, into the cells around it, if all these are in the field."""
    cells, span = len(offset), int(MAX_DISTANCE / FIELD_CELL)
    row, column = math.floor(x), math.floor(y)
    if row < span or column < span or row >= cells - span or column >= cells - span:
        return
    dx = FIELD_CELL * (x - row - 0.5) + OFFSET_UNIT * offset[row, column, 0]  # from the nearest point so far
    dy = FIELD_CELL * (y - column - 0.5) + OFFSET_UNIT * offset[row, column, 1]
    if dx * dx + dy * dy < SAME_POINT * SAME_POINT:
        return
    for i in range(row - span, row + span + 1):
        dx = FIELD_CELL * (i + 0.5 - x)
        for j in range(column - span, column + span + 1):
            dy = FIELD_CELL * (j + 0.5 - y)
            squared = dx * dx + dy * dy
            if squared < MAX_DISTANCE * MAX_DISTANCE and squared < _squared(offset[i, j]):
                offset[i, j, 0], offset[i, j, 1] = round(dx / OFFSET_UNIT), round(dy / OFFSET_UNIT)


@compiled
def _squared(offset):  # type: ignore[no-untyped-def]
    """Return the squared length of an offset, square metres; more than the square of MAX_DISTANCE if there is none."""
    x, y = OFFSET_UNIT * offset[0], OFFSET_UNIT * offset[1]
    return x * x + y * y


@compiled
def facing_grid(normal_x, normal_y):  # type: ignore[no-untyped-def]
    """Return the number of the grid for a surface with a normal, that of all points if the normal is zero."""
    if normal_x == 0.0 and normal_y == 0.0:
        return ALL_POINTS
    if abs(normal_x) >= abs(normal_y):
        return 0 if normal_x > 0.0 else 2
    return 1 if normal_y > 0.0 else 3


@compiled
def _mark_seen(seen, x, y, end_x, end_y):  # type: ignore[no-untyped-def]
    """Mark the cells on the line from (x, y) to the end, both in cells."""
    cells = len(seen)
    steps = int(1.5 * max(abs(end_x - x), abs(end_y - y))) + 1
    for k in range(steps + 1):
        row, column = math.floor(x + (end_x - x) * k / steps), math.floor(y + (end_y - y) * k / steps)
        if 0 <= row < cells and 0 <= column < cells:
            seen[row, column] = 1


@compiled
def nearest_distance(offset, x, y):  # type: ignore[no-untyped-def]
    """Return the distance (metres) from the cell of (x, y), in cells, to the nearest point; at most MAX_DISTANCE."""
    i, j = math.floor(x), math.floor(y)
    if i < 0 or j < 0 or i >= len(offset) or j >= len(offset):
        return MAX_DISTANCE
    return min(MAX_DISTANCE, math.sqrt(_squared(offset[i, j])))


@compiled
def interpolate(offset, x, y):  # type: ignore[no-untyped-def]
    """Return the vector (metres) from the nearest point to (x, y), in cells, and False if there is no point.

    It is interpolated between those from the points that are nearest to the four cells around, so that it is linear
    near a surface. Those from another surface, on the other side, are left out.
    """
    i, j = math.floor(x - 0.5), math.floor(y - 0.5)
    if i < 0 or j < 0 or i >= len(offset) - 1 or j >= len(offset) - 1:
        return 0.0, 0.0, False
    a, b = x - 0.5 - i, y - 0.5 - j
    near_i, near_j = i + (a >= 0.5), j + (b >= 0.5)
    if offset[near_i, near_j, 0] == NOWHERE:
        return 0.0, 0.0, False
    near_x = FIELD_CELL * (x - near_i - 0.5) + OFFSET_UNIT * offset[near_i, near_j, 0]
    near_y = FIELD_CELL * (y - near_j - 0.5) + OFFSET_UNIT * offset[near_i, near_j, 1]
    sum_x, sum_y, total = 0.0, 0.0, 0.0
    for row in range(2):
        for column in range(2):
            if offset[i + row, j + column, 0] == NOWHERE:
                continue
            dx = FIELD_CELL * (x - i - row - 0.5) + OFFSET_UNIT * offset[i + row, j + column, 0]
            dy = FIELD_CELL * (y - j - column - 0.5) + OFFSET_UNIT * offset[i + row, j + column, 1]
            if dx * near_x + dy * near_y < 0.0 and dx * dx + dy * dy > FIELD_CELL * FIELD_CELL:
                continue
            weight = (a if row else 1.0 - a) * (b if column else 1.0 - b)
            sum_x, sum_y, total = sum_x + weight * dx, sum_y + weight * dy, total + weight
    return sum_x / total, sum_y / total, True


@compiled
def is_seen(seen, x, y):  # type: ignore[no-untyped-def]
    """True if (x, y), in cells of FIELD_CELL, lies in a cell that was seen."""
    row, column = math.floor(x * FIELD_CELL / SEEN_CELL), math.floor(y * FIELD_CELL / SEEN_CELL)
    return 0 <= row < len(seen) and 0 <= column < len(seen) and seen[row, column] > 0


@compiled
def add_points(pose, points, offset, seen, origin, sigma, information, gradient):  # type: ignore[no-untyped-def]
    """Add the normal equations of points (p, 4) with normals, in the base's frame, with the base at `pose`.

    Each point measures the offset from the nearest point of the field along its normal, or along both axes if it has
    none. The offset is zero with standard deviation `sigma` (metres) and a Cauchy kernel of the same scale. Points in
    unseen cells are left out: what is seen for the first time, such as the continuation of a wall, is near known points
    without being at them. Information (3, 3) and gradient (3,) refer to the base's axes and must be zero before.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(points)):
        lever_x, lever_y = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        x, y = (pose[0] + lever_x - origin[0]) / FIELD_CELL, (pose[1] + lever_y - origin[1]) / FIELD_CELL
        if not is_seen(seen, x, y):
            continue
        normal_x, normal_y = c * points[k, 2] - s * points[k, 3], s * points[k, 2] + c * points[k, 3]
        grid = facing_grid(normal_x, normal_y)
        dx, dy, found = interpolate(offset[grid], x, y)
        if not found:
            continue
        weight = 1.0 / (sigma * sigma + dx * dx + dy * dy)
        if grid != ALL_POINTS:
            _add_row(points[k], normal_x, normal_y, c, s, weight, normal_x * dx + normal_y * dy, information, gradient)
        else:
            _add_row(points[k], 1.0, 0.0, c, s, weight, dx, information, gradient)
            _add_row(points[k], 0.0, 1.0, c, s, weight, dy, information, gradient)
    information[1, 0], information[2, 0], information[2, 1] = information[0, 1], information[0, 2], information[1, 2]


@compiled
def _add_row(point, x, y, c, s, weight, residual, information, gradient):  # type: ignore[no-untyped-def]
    """Add one equation: the point is `residual` metres off along the unit vector (x, y) of the map."""
    forward, left = c * x + s * y, -s * x + c * y
    turn = point[0] * left - point[1] * forward
    gradient[0] += weight * residual * forward
    gradient[1] += weight * residual * left
    gradient[2] += weight * residual * turn
    information[0, 0] += weight * forward * forward
    information[1, 1] += weight * left * left
    information[2, 2] += weight * turn * turn
    information[0, 1] += weight * forward * left
    information[0, 2] += weight * forward * turn
    information[1, 2] += weight * left * turn

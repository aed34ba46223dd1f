"""Points of a map that are at rest, thinned: beams end there at least as often as they pass through.

People, and doors that were opened, are no part of a place: the beams of other scans cross the points where they stood.
The squares of the thinned points are the cells of an occupancy grid in which a hit and a crossing weigh the same.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled, inlined

from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import SURFACE_DEPTH
from ..matching.free_space import NEW_SURFACE

# Metres between the points kept of a surface, so that evidence does not depend on how often the surface was seen.
# Origin: definition.
THINNED_SPACING = SURFACE_DEPTH
# Metres from a point without a normal beyond which a beam has left its square. Origin: definition, its diagonal.
SQUARE_DIAGONAL = math.sqrt(2.0) * THINNED_SPACING
# Directions that surfaces face, and one for points without a normal. Origin: definition.
FACINGS = 5


def points_at_rest(starts: Floats, points: Floats) -> Floats:
    """Return the points (n, 6) at rest: one of each square whose surfaces face in about one direction.

    starts  (p, 2) where the robot was when it saw each point
    points  (p, 6) with normals, within some kilometres
    """
    if not len(points):
        return points
    squares = np.floor(points[:, :2] / THINNED_SPACING)
    corner = squares.min(axis=0)
    row, column = (squares - corner).astype(np.int64).T
    # One number for each square and direction: to compare rows takes ten times as long.
    _, first, hits = np.unique(
        (row * (column.max() + 1) + column) * FACINGS + _facings(points), return_index=True, return_counts=True
    )
    thinned = np.ascontiguousarray(points[first])
    row_starts = np.searchsorted(row[first], np.arange(row.max() + 2))
    crossings = _count_crossings(
        thinned, row_starts, column[first], corner, np.ascontiguousarray(starts), np.ascontiguousarray(points[:, :2])
    )
    return np.ascontiguousarray(thinned[hits >= crossings])


def _facings(points: Floats) -> Integers:
    """Return (p,) the direction that the surface of each point faces, 0 to 3, or 4 without a normal."""
    facing = np.round(np.arctan2(points[:, 3], points[:, 2]) / (0.5 * math.pi)).astype(np.int64) % (FACINGS - 1)
    facing[~points[:, 2:4].any(axis=1)] = FACINGS - 1
    return facing


@compiled
def _count_crossings(points, row_starts, columns, corner, starts, ends):  # type: ignore[no-untyped-def]
    """Return (n,) how many beams cross the surface at each of the thinned points (n, 6).

    Row r of squares, counted from `corner` (2,), has the points row_starts[r] to row_starts[r + 1], which are sorted by
    their `columns` (n,). A grid of all squares would need the square of that memory.

    starts, ends  (p, 2) of the beams, metres
    """
    crossings = np.zeros(len(points), dtype=np.int64)
    rows = len(row_starts) - 1
    for k in range(len(ends)):
        x, y = starts[k, 0] / THINNED_SPACING - corner[0], starts[k, 1] / THINNED_SPACING - corner[1]
        end_x, end_y = ends[k, 0] / THINNED_SPACING - corner[0], ends[k, 1] / THINNED_SPACING - corner[1]
        steps = int(1.5 * max(abs(end_x - x), abs(end_y - y))) + 1
        last_row, last_column = -1, -1
        for step in range(steps):
            row = math.floor(x + step * (end_x - x) / steps)
            column = math.floor(y + step * (end_y - y) / steps)
            if (row == last_row and column == last_column) or not 0 <= row < rows:
                continue
            last_row, last_column = row, column
            index, end = row_starts[row], row_starts[row + 1]
            index += np.searchsorted(columns[index:end], column)
            while index < end and columns[index] == column:
                crossings[index] += _is_crossed(points[index], starts[k], ends[k])
                index += 1
    return crossings


@inlined
def _is_crossed(point, start, end):  # type: ignore[no-untyped-def]
    """Return True if a beam that touches the square of a point (6,) goes on behind the surface there.

    A beam along a wall touches many squares of it and ends on it, so both ends must be off the wall on different sides.
    """
    if point[2] == 0.0 and point[3] == 0.0:
        return math.hypot(end[0] - point[0], end[1] - point[1]) > SQUARE_DIAGONAL
    before = point[2] * (start[0] - point[0]) + point[3] * (start[1] - point[1])
    behind = point[2] * (end[0] - point[0]) + point[3] * (end[1] - point[1])
    return before * behind < 0.0 and min(abs(before), abs(behind)) > NEW_SURFACE

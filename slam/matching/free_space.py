"""Free space of the distance field, and points that appear in it and wait before they enter the field.

A person who follows the robot keeps its distance. If the scans' points on such a person entered the field, the next
scans would fit best if the robot had not moved. So a point in free space, around which beams have crossed all cells and
where no surface is known, waits: it enters the field if a later scan has a point there as well.

A lidar that tilts on a ramp or a threshold sees the floor as a straight line, which comes nearer and recedes. What
moves to and fro passes a place twice, and may be seen there twice, but only a body at rest is seen there three times in
a row. The line may be as long as a wall and extend into space that was not seen before. So a line is held as a whole
until then: none of its points enters if more of them have appeared in free space than are on known surfaces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import inlined

from ..geometry.surroundings import SURFACE_DEPTH
from .offset_tiles import FIELD_CELL
from .scan_points import LINE_DISTANCE

# Metres, side of the cells in which it is stored whether a beam crossed them. Origin: chosen; not measured.
SEEN_CELL = 0.25
# The same in cells of the distance field. Origin: definition.
SEEN_CELLS = round(SEEN_CELL / FIELD_CELL)
# Metres from the nearest known point beyond which a point in free space is on no known surface, and side of the cells
# in which points wait. Origin: definition.
NEW_SURFACE = SURFACE_DEPTH
# The side of these cells in cells of the distance field. Origin: definition.
WAITING_CELLS = round(NEW_SURFACE / FIELD_CELL)
# Scans in a row that have a point at a place if a body rests there. Origin: geometry, a position that is quadratic in
# time has each value twice at most.
SIGHTINGS = 3
# Units of what is stored for a cell, see `WaitingPoints`. Origin: definition, more than SIGHTINGS, and twice as much.
SEEN_BEFORE, LAST_SCAN = 4, 8
# Kinds of a scan's points: outside the field; in space that was not seen before; on a known surface, or at rest;
# in free space where a scan before had a point as well; and where none had. Origin: definition.
OUTSIDE, IN_UNSEEN_SPACE, KNOWN, APPEARED, NEW = 0, 1, 2, 3, 4
# Bit that is set in the kind of a point on a line that is held. Origin: definition.
HELD = 8


@dataclass(slots=True, eq=False)
class WaitingPoints:
    """Cells of NEW_SURFACE in which points wait.

    cells  (w, w) one number for each cell, 0 if no scan had a point in free space there: the number of the last scan
           that had one, counted from 1, times LAST_SCAN; SEEN_BEFORE if an earlier scan had one, too; and the number of
           scans in a row with one up to the last, SIGHTINGS at most
    scans  number of scans that have been inserted
    """

    cells: NDArray[np.int32]
    scans: int = 0

    @classmethod
    def empty(cls, side: int) -> WaitingPoints:
        """Return cells without points for a field with `side` seen cells on each side."""
        cells = -(-side * SEEN_CELLS // WAITING_CELLS)
        return cls(np.zeros((cells, cells), dtype=np.int32))

    def clear(self) -> None:
        """Remove all points."""
        self.cells.fill(0)
        self.scans = 0

    def copy(self) -> WaitingPoints:
        """Return an independent copy."""
        return WaitingPoints(self.cells.copy(), self.scans)


@inlined
def mark_seen(seen, x, y, end_x, end_y):  # type: ignore[no-untyped-def]
    """Mark the cells on the line from (x, y) to (end_x, end_y), all in cells of SEEN_CELL, as seen."""
    cells = len(seen)
    steps = int(1.5 * max(abs(end_x - x), abs(end_y - y))) + 1
    step_x, step_y = (end_x - x) / steps, (end_y - y) / steps
    inside = min(x, y, end_x, end_y) >= 1.0 and max(x, y, end_x, end_y) < cells - 1  # even if rounded
    for k in range(steps + 1):
        row, column = math.floor(x + k * step_x), math.floor(y + k * step_y)
        if inside or (0 <= row < cells and 0 <= column < cells):
            seen[np.uintp(row), np.uintp(column)] = 1


@inlined
def is_seen(seen, x, y):  # type: ignore[no-untyped-def]
    """Return True if (x, y), in cells of FIELD_CELL, lies in a cell that was seen."""
    row, column, cells = math.floor(x), math.floor(y), SEEN_CELLS * len(seen)
    if row < 0 or column < 0 or row >= cells or column >= cells:
        return False
    return seen[np.uintp(row // SEEN_CELLS), np.uintp(column // SEEN_CELLS)] > 0


@inlined
def is_surrounded(seen, x, y):  # type: ignore[no-untyped-def]
    """Return True if the cell of (x, y), in cells of FIELD_CELL, and all its neighbours were seen: no wall is there."""
    row, column = math.floor(x) // SEEN_CELLS, math.floor(y) // SEEN_CELLS
    for i in range(row - 1, row + 2):
        for j in range(column - 1, column + 2):
            if seen[i, j] == 0:
                return False
    return True


@inlined
def add_sighting(waiting, scan, x, y):  # type: ignore[no-untyped-def]
    """Store that the scan numbered `scan` has a point in the cell of (x, y).

    Returns if a scan before had one, and if SIGHTINGS scans in a row had. For `waiting` see `WaitingPoints.cells`.
    """
    i, j = math.floor(x) // WAITING_CELLS, math.floor(y) // WAITING_CELLS
    cell = waiting[i, j]
    last = cell // LAST_SCAN
    if last != scan:
        in_row = min(cell % SEEN_BEFORE + 1, SIGHTINGS) if 0 < last == scan - 1 else 1
        cell = scan * LAST_SCAN + (SEEN_BEFORE if last > 0 else 0) + in_row
        waiting[i, j] = cell
    return cell % LAST_SCAN >= SEEN_BEFORE, cell % SEEN_BEFORE >= SIGHTINGS


@inlined
def hold_lines(points, kinds):  # type: ignore[no-untyped-def]
    """Set HELD in the kinds of all points on a line if more of them have appeared in free space than are KNOWN.

    points  (p, 6) of one scan, with their normals
    kinds   (p,) kinds of the points, none of which is held
    """
    for k in range(len(points)):
        normal_x, normal_y = points[k, 2], points[k, 3]
        if kinds[k] & ~HELD < APPEARED or (normal_x == 0.0 and normal_y == 0.0):
            continue
        same_line = k > 0 and points[k - 1, 2] == normal_x and points[k - 1, 3] == normal_y
        if same_line and kinds[k - 1] & ~HELD >= APPEARED:
            continue  # the point before has decided
        appeared, known = 0, 0
        for j in range(len(points)):
            if _is_on_line(points, j, k):
                appeared += kinds[j] & ~HELD >= APPEARED
                known += kinds[j] & ~HELD == KNOWN
        if appeared > known:
            for j in range(len(points)):
                if _is_on_line(points, j, k):
                    kinds[j] |= HELD


@inlined
def _is_on_line(points, j, k):  # type: ignore[no-untyped-def]
    """Return True if point j of (p, 6) is on the line through point k across its normal."""
    x, y = points[j, 0] - points[k, 0], points[j, 1] - points[k, 1]
    return abs(points[k, 2] * x + points[k, 3] * y) < LINE_DISTANCE

"""Free space of a distance field: the cells that beams have crossed, and points that appear where there was nothing.

A person who follows the robot keeps its distance. If the scans' points on such a person entered the field, the next
scans would fit best if the robot had not moved. So a point in free space, around which beams have crossed all cells and
where no surface is known, waits: it enters the field if a later scan has a point there as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import inlined

from .offset_tiles import FIELD_CELL

# Metres, side of the cells in which it is stored whether a beam crossed them. Origin: chosen; not measured.
SEEN_CELL = 0.25
# The same in cells of the distance field. Origin: definition.
SEEN_CELLS = round(SEEN_CELL / FIELD_CELL)
# Metres from the nearest known point beyond which a point in free space is on no known surface, and side of the cells
# in which points wait. Origin: chosen, as far as the noise of usual lidars moves a point.
NEW_SURFACE = 0.1
# The side of these cells in cells of the distance field. Origin: definition.
WAITING_CELLS = round(NEW_SURFACE / FIELD_CELL)


@dataclass(slots=True, eq=False)
class WaitingPoints:
    """Cells of NEW_SURFACE in which points wait.

    scan_of  (w, w) number of the scan, counted from 1, whose point waits in the cell; 0 if none does
    scans    number of scans that have been inserted
    """

    scan_of: NDArray[np.int32]
    scans: int = 0

    @classmethod
    def empty(cls, side: int) -> WaitingPoints:
        """Return cells without points for a field with `side` seen cells on each side."""
        cells = -(-side * SEEN_CELLS // WAITING_CELLS)
        return cls(np.zeros((cells, cells), dtype=np.int32))

    def clear(self) -> None:
        """Remove all points."""
        self.scan_of.fill(0)
        self.scans = 0

    def copy(self) -> WaitingPoints:
        """Return an independent copy."""
        return WaitingPoints(self.scan_of.copy(), self.scans)


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
def must_wait(scan_of, scan, x, y):  # type: ignore[no-untyped-def]
    """Return True if no scan before the one numbered `scan` had a point in the cell of (x, y); store that it has."""
    i, j = math.floor(x) // WAITING_CELLS, math.floor(y) // WAITING_CELLS
    if 0 < scan_of[i, j] < scan:
        return False
    scan_of[i, j] = scan
    return True

"""Build an occupancy grid: count for each square cell the beams that ended in it and those that passed through it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled

from ...errors import MapError
from ...geometry.segments import Floats
from .scan_placement import PlacedScan

Counts = NDArray[np.int32]
Cells = NDArray[np.int64]

FREE, UNKNOWN, OCCUPIED = 0, -1, 100
"""Values of a ROS OccupancyGrid."""
GROWTH = 200
"""Extra cells on a side on which the grid grows, so that it does not grow with every scan."""
MAX_CELLS = 400_000_000
"""Largest size of the grid: 1 km by 1 km at 0.05 m. More is a mistake in the resolution, or needs too much memory."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds on the share of the beams reaching a cell that end in it.

    occupied  the cell is occupied from this share on. Of a wall that crosses a cell near its edge, about three quarters
              of the beams that reach the cell pass on to its neighbours
    free      the cell is free up to this share; in between it is unknown
    """

    occupied: float = 0.25
    free: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Occupancy:
    """Occupancy of square cells.

    cells       (rows, columns) of FREE, OCCUPIED or UNKNOWN; the first row has the lowest y
    origin      (2,) corner of the first cell with the lowest x and y, metres in the map
    resolution  side of a cell, metres
    """

    cells: NDArray[np.int8]
    origin: Floats
    resolution: float

    def centres(self, state: int) -> Floats:
        """Return the centres (n, 2) of the cells in a state, metres in the map."""
        rows, columns = np.nonzero(self.cells == state)
        return np.asarray(self.origin + self.resolution * (np.column_stack([columns, rows]) + 0.5))


class OccupancyGrid:
    """Growing grid of beam counts, with cells of `resolution` metres whose edges lie on multiples of it."""

    def __init__(self, resolution: float) -> None:
        if not 0.0 < resolution < np.inf:
            raise MapError(f"a resolution of {resolution:g} m is not possible")
        self._resolution = resolution
        self._low: Cells = np.zeros(2, dtype=np.int64)  # x, y of the first cell, counted from the map's origin
        self._ended: Counts = np.zeros((0, 0), dtype=np.int32)
        self._passed: Counts = np.zeros((0, 0), dtype=np.int32)

    def add(self, scan: PlacedScan) -> None:
        """Count the beams of a scan. Raises MapError if the grid would become larger than MAX_CELLS."""
        if not len(scan.points):
            return
        start = scan.origin / self._resolution
        ends = scan.points / self._resolution
        corners = np.vstack([start, ends])
        self._grow(np.floor(corners.min(axis=0)), np.floor(corners.max(axis=0)))
        trace_beams(self._ended, self._passed, self._low, start, ends)

    def add_all(self, scans: Iterable[PlacedScan]) -> int:
        """Count the beams of several scans and return the number of scans."""
        count = 0
        for scan in scans:
            self.add(scan)
            count += 1
        return count

    def _grow(self, low: Floats, high: Floats) -> None:
        """Extend the grid to contain the cells from `low` to `high` (2,)."""
        size = np.array(self._ended.shape[::-1])
        below = (self._low - low).astype(np.int64)
        above = (high + 1 - self._low - size).astype(np.int64)
        if not size.any():
            self._low, below, above = low.astype(np.int64), np.zeros(2, np.int64), (high + 1 - low).astype(np.int64)
        if (below <= 0).all() and (above <= 0).all():
            return
        before = np.where(below > 0, below + GROWTH, 0)
        after = np.where(above > 0, above + GROWTH, 0)
        cells = int(np.prod((size + before + after).astype(float)))
        if cells > MAX_CELLS:
            limit = f"{MAX_CELLS / 1e6:.0f} million"
            raise MapError(f"cells of {self._resolution:g} m make a grid of more than {limit}; make them larger")
        padding = list(zip(before.tolist()[::-1], after.tolist()[::-1], strict=True))
        self._ended, self._passed = np.pad(self._ended, padding), np.pad(self._passed, padding)
        self._low = self._low - before

    def occupancy(self, thresholds: Thresholds | None = None) -> Occupancy:
        """Return the occupancy, cropped to the cells that a beam reached. Raises MapError if there is none."""
        thresholds = thresholds or Thresholds()
        reached = self._ended + self._passed
        rows, columns = np.nonzero(reached.any(axis=1))[0], np.nonzero(reached.any(axis=0))[0]
        if not len(rows):
            raise MapError("no beam of any scan hit anything, so there is nothing to draw")
        window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        share = self._ended[window] / np.maximum(reached[window], 1)
        cells = np.full(share.shape, UNKNOWN, dtype=np.int8)
        cells[(share <= thresholds.free) & (reached[window] > 0)] = FREE
        cells[(share >= thresholds.occupied) & (reached[window] > 0)] = OCCUPIED
        origin = self._resolution * (self._low + np.array([columns[0], rows[0]]))
        return Occupancy(cells, origin.astype(np.float64), self._resolution)


@compiled
def trace_beams(ended: Counts, passed: Counts, low: Cells, start: Floats, ends: Floats) -> None:
    """Count the beams from `start` (2,) to `ends` (n, 2), in cells, by the algorithm of Amanatides and Woo (1987).

    ended   (rows, columns) count of the cell that a beam ends in
    passed  (rows, columns) counts of the cells that it crosses before
    low     (2,) x, y of the first cell of the counts. It is subtracted from cell indices only: which cell a beam ends
            in must not depend on the extent of the grid
    """
    first_x, first_y = int(np.floor(start[0])), int(np.floor(start[1]))
    for k in range(ends.shape[0]):
        x, y = first_x, first_y
        last_x, last_y = int(np.floor(ends[k, 0])), int(np.floor(ends[k, 1]))
        step_x = 1 if last_x > x else -1
        step_y = 1 if last_y > y else -1
        left_x, left_y = abs(last_x - x), abs(last_y - y)  # edges still to be crossed
        length_x, length_y = abs(ends[k, 0] - start[0]), abs(ends[k, 1] - start[1])
        # Shares of the beam from one edge to the next in x and y, and from the start to the next edge.
        each_x = 1.0 / length_x if length_x > 0.0 else np.inf
        each_y = 1.0 / length_y if length_y > 0.0 else np.inf
        next_x = abs((x + (step_x > 0)) - start[0]) * each_x if left_x else np.inf
        next_y = abs((y + (step_y > 0)) - start[1]) * each_y if left_y else np.inf
        while left_x or left_y:
            passed[y - low[1], x - low[0]] += 1
            if left_x and (next_x <= next_y or not left_y):
                x += step_x
                left_x -= 1
                next_x += each_x
            else:
                y += step_y
                left_y -= 1
                next_y += each_y
        ended[last_y - low[1], last_x - low[0]] += 1

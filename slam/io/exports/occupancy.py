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
TILE = 64
"""Side of a tile, in cells: where beams were added or removed, the occupancy is computed again by tiles."""
GROWTH = 3
"""Extra tiles on a side on which the grid grows, so that it does not grow with every scan."""
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
    """Growing grid of beam counts, with cells of `resolution` metres whose edges lie on multiples of it.

    Memory and the time of `occupancy` are proportional to the area, that of `add` and `remove` to the scan.
    """

    def __init__(self, resolution: float) -> None:
        if not 0.0 < resolution < np.inf:
            raise MapError(f"a resolution of {resolution:g} m is not possible")
        self._resolution = resolution
        self._low: Cells = np.zeros(2, dtype=np.int64)  # x, y of the first tile, counted from the map's origin
        self._ended: Counts = np.zeros((0, 0), dtype=np.int32)
        self._passed: Counts = np.zeros((0, 0), dtype=np.int32)
        self._cells: NDArray[np.int8] = np.zeros((0, 0), dtype=np.int8)
        self._changed: NDArray[np.bool_] = np.zeros((0, 0), dtype=np.bool_)  # tiles whose cells are not up to date
        self._reached: NDArray[np.bool_] = np.zeros((0, 0), dtype=np.bool_)  # tiles that a beam has reached
        self._thresholds = Thresholds()

    def add(self, scan: PlacedScan) -> None:
        """Count the beams of a scan. Raises MapError if the grid would become larger than MAX_CELLS."""
        self._count(scan, 1)

    def remove(self, scan: PlacedScan) -> None:
        """Count the beams of a scan that was added before no longer."""
        self._count(scan, -1)

    def add_all(self, scans: Iterable[PlacedScan]) -> int:
        """Count the beams of several scans and return the number of scans."""
        count = 0
        for scan in scans:
            self.add(scan)
            count += 1
        return count

    def _count(self, scan: PlacedScan, weight: int) -> None:
        if not len(scan.points):
            return
        start = scan.origin / self._resolution
        ends = scan.points / self._resolution
        corners = np.vstack([start, ends])
        low = np.floor(np.floor(corners.min(axis=0)) / TILE)
        high = np.floor(np.floor(corners.max(axis=0)) / TILE)
        self._grow(low, high)
        first, last = (low - self._low).astype(np.int64), (high - self._low).astype(np.int64)
        self._changed[first[1] : last[1] + 1, first[0] : last[0] + 1] = True
        trace_beams(self._ended, self._passed, TILE * self._low, start, ends, weight)

    def _grow(self, low: Floats, high: Floats) -> None:
        """Extend the grid to contain the tiles from `low` to `high` (2,)."""
        size = np.array(self._changed.shape[::-1])
        below = (self._low - low).astype(np.int64)
        above = (high + 1 - self._low - size).astype(np.int64)
        if not size.any():
            self._low, below, above = low.astype(np.int64), np.zeros(2, np.int64), (high + 1 - low).astype(np.int64)
        if (below <= 0).all() and (above <= 0).all():
            return
        before = np.where(below > 0, below + GROWTH, 0)
        after = np.where(above > 0, above + GROWTH, 0)
        cells = TILE**2 * int(np.prod((size + before + after).astype(float)))
        if cells > MAX_CELLS:
            limit = f"{MAX_CELLS / 1e6:.0f} million"
            raise MapError(f"cells of {self._resolution:g} m make a grid of more than {limit}; make them larger")
        tiles = list(zip(before.tolist()[::-1], after.tolist()[::-1], strict=True))
        padding = [(TILE * one, TILE * other) for one, other in tiles]
        self._ended, self._passed = np.pad(self._ended, padding), np.pad(self._passed, padding)
        self._cells = np.pad(self._cells, padding, constant_values=UNKNOWN)
        self._changed, self._reached = np.pad(self._changed, tiles), np.pad(self._reached, tiles)
        self._low = self._low - before

    def occupancy(self, thresholds: Thresholds | None = None) -> Occupancy:
        """Return the occupancy, cropped to the cells that a beam reached. Raises MapError if there is none.

        It is computed where the counts have changed since the last call.
        """
        thresholds = thresholds or Thresholds()
        if thresholds != self._thresholds:
            self._thresholds, self._changed = thresholds, np.ones_like(self._changed)
        counts, limits = (self._ended, self._passed), (thresholds.occupied, thresholds.free)
        compute_cells(*counts, self._cells, self._changed, self._reached, *limits)
        self._changed[:] = False
        if not self._reached.any():
            raise MapError("no beam of any scan hit anything, so there is nothing to draw")
        rows, columns = self._extent(1), self._extent(0)
        origin = self._resolution * (TILE * self._low + np.array([columns.start, rows.start]))
        return Occupancy(self._cells[rows, columns].copy(), origin.astype(np.float64), self._resolution)

    def _extent(self, axis: int) -> slice:
        """Return the rows (axis 1) or columns (axis 0) from the first to the last that a beam reached."""
        tiles = np.nonzero(self._reached.any(axis=axis))[0]
        first, last = self._in_tile(tiles[0], axis), self._in_tile(tiles[-1], axis)
        return slice(TILE * int(tiles[0]) + int(first[0]), TILE * int(tiles[-1]) + int(last[-1]) + 1)

    def _in_tile(self, tile: int, axis: int) -> Cells:
        """Return the rows or columns within those of a tile that a beam reached."""
        within = slice(TILE * tile, TILE * (tile + 1))
        window = (within, slice(None)) if axis == 1 else (slice(None), within)
        return np.asarray(np.nonzero((self._ended[window] + self._passed[window]).any(axis=axis))[0])


@compiled
def compute_cells(ended, passed, cells, changed, reached, occupied, free):  # type: ignore[no-untyped-def]
    """Compute the values of the `cells` (rows, columns) in the `changed` tiles from the counts of beams.

    reached         set to True for tiles that a beam has reached, else to False, where they have changed
    occupied, free  thresholds
    """
    for row in range(changed.shape[0]):
        for column in range(changed.shape[1]):
            if not changed[row, column]:
                continue
            reached[row, column] = False
            for y in range(TILE * row, TILE * (row + 1)):
                for x in range(TILE * column, TILE * (column + 1)):
                    count = ended[y, x] + passed[y, x]
                    cells[y, x] = UNKNOWN
                    if count > 0:
                        reached[row, column] = True
                        share = ended[y, x] / count
                        if share >= occupied:
                            cells[y, x] = OCCUPIED
                        elif share <= free:
                            cells[y, x] = FREE


@compiled
def trace_beams(ended: Counts, passed: Counts, low: Cells, start: Floats, ends: Floats, weight: int) -> None:
    """Count the beams from `start` (2,) to `ends` (n, 2), in cells, by the algorithm of Amanatides and Woo (1987).

    ended   (rows, columns) count of the cell that a beam ends in
    passed  (rows, columns) counts of the cells that it crosses before
    low     (2,) x, y of the first cell of the counts. It is subtracted from cell indices only: which cell a beam ends
            in must not depend on the extent of the grid
    weight  by which the counts grow: 1, or -1 to remove beams that were counted before
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
            passed[y - low[1], x - low[0]] += weight
            if left_x and (next_x <= next_y or not left_y):
                x += step_x
                left_x -= 1
                next_x += each_x
            else:
                y += step_y
                left_y -= 1
                next_y += each_y
        ended[last_y - low[1], last_x - low[0]] += weight

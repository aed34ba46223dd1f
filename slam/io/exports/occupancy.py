"""Build an occupancy grid: count for each square cell the beams that ended in it and those that passed through it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled
from drivers.immutable import immutable

from ...errors import MapError
from ...geometry.segments import Floats
from .scan_placement import PlacedScan

Counts = NDArray[np.int32]
Cells = NDArray[np.int64]
Kind = TypeVar("Kind", bound=np.generic)

FREE, UNKNOWN, OCCUPIED = 0, -1, 100
"""Values of a ROS OccupancyGrid."""
TILE = 64
"""Side of a tile, in cells: memory is needed for the tiles around scans, and where beams were added or removed, the
occupancy is computed again by tiles."""
GROWTH = 3
"""Extra tiles on a side on which the grid grows, so that it does not grow with every scan."""
RESERVE = 1 / 8
"""Share of the tiles for which more memory is reserved when it is used up."""
MAX_CELLS = 400_000_000
"""Largest size of the grid: 1 km by 1 km at 0.05 m. More is a mistake in the resolution, or a point far away."""
MAX_INDEX = 2.0**52
"""Cells from the map's origin; farther ones cannot be told apart."""
MAX_SEEN = 100_000_000
"""Most cells of tiles around scans, which need 9 bytes each: 0.25 km² at 0.05 m."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds on the share of the beams reaching a cell that end in it.

    occupied  the cell is occupied from this share on. Of a wall that crosses a cell near its edge, about three quarters
              of the beams that reach the cell pass on to its neighbours
    free      the cell is free up to this share; in between it is unknown
    """

    occupied: float = 0.25
    free: float = 0.1


@immutable
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

    Counts are stored for the tiles around scans only. Memory is proportional to what they have seen, the time of
    `occupancy` to the area of the grid, that of `add` and `remove` to the scan.
    """

    def __init__(self, resolution: float) -> None:
        if not 0.0 < resolution < np.inf:
            raise MapError(f"a resolution of {resolution:g} m is not possible")
        self._resolution = resolution
        self._low: Cells = np.zeros(2, dtype=np.int64)  # x, y of the first tile, counted from the map's origin
        self._slots: Counts = np.zeros((0, 0), dtype=np.int32)  # of each tile in the arrays below; -1 without counts
        self._used = 0  # slots
        self._ended: Counts = np.zeros((0, TILE, TILE), dtype=np.int32)
        self._passed: Counts = np.zeros((0, TILE, TILE), dtype=np.int32)
        self._cells: NDArray[np.int8] = np.zeros((0, TILE, TILE), dtype=np.int8)
        self._changed: NDArray[np.bool_] = np.zeros(0, dtype=np.bool_)  # tiles whose cells are not up to date
        self._reached: NDArray[np.bool_] = np.zeros(0, dtype=np.bool_)  # tiles that a beam has reached
        self._thresholds = Thresholds()

    def add(self, scan: PlacedScan) -> None:
        """Count the beams of a scan. Raises MapError if the grid would become larger than MAX_CELLS or MAX_SEEN."""
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
        if not (np.abs(corners) < MAX_INDEX).all():
            raise MapError(f"a scan is too far from the origin of the map for cells of {self._resolution:g} m")
        low = np.floor(np.floor(corners.min(axis=0)) / TILE)
        high = np.floor(np.floor(corners.max(axis=0)) / TILE)
        self._grow(low, high)
        first, last = (low - self._low).astype(np.int64), (high - self._low).astype(np.int64)
        around = self._slots[first[1] : last[1] + 1, first[0] : last[0] + 1]
        self._reserve(around)
        self._changed[around] = True
        trace_beams(self._ended, self._passed, self._slots, TILE * self._low, start, ends, weight)

    def _grow(self, low: Floats, high: Floats) -> None:
        """Extend the grid to contain the tiles from `low` to `high` (2,)."""
        size = np.array(self._slots.shape[::-1])
        below = (self._low - low).astype(np.int64)
        above = (high + 1 - self._low - size).astype(np.int64)
        if not size.any():
            self._low, below, above = low.astype(np.int64), np.zeros(2, np.int64), (high + 1 - low).astype(np.int64)
        if (below <= 0).all() and (above <= 0).all():
            return
        before = np.where(below > 0, below + GROWTH, 0)
        after = np.where(above > 0, above + GROWTH, 0)
        self._check_size(TILE**2 * float(np.prod((size + before + after).astype(float))), MAX_CELLS)
        tiles = list(zip(before.tolist()[::-1], after.tolist()[::-1], strict=True))
        self._slots = np.pad(self._slots, tiles, constant_values=-1)
        self._low = self._low - before

    def _reserve(self, slots: Counts) -> None:
        """Give each of some tiles a slot, a part of `_slots` that is changed, if it has none."""
        new = slots < 0
        count = self._used + int(new.sum())
        self._check_size(TILE**2 * count, MAX_SEEN)
        if count > len(self._changed):
            more = count + int(RESERVE * count) - len(self._changed)
            self._ended, self._passed = _with_zeros(self._ended, more), _with_zeros(self._passed, more)
            self._cells = _with_zeros(self._cells, more)
            self._changed, self._reached = _with_zeros(self._changed, more), _with_zeros(self._reached, more)
        slots[new] = np.arange(self._used, count)
        self._used = count

    def _check_size(self, cells: float, limit: int) -> None:
        if cells > limit:
            size = f"{limit / 1e6:.0f} million"
            raise MapError(f"cells of {self._resolution:g} m make a grid of more than {size}; make them larger")

    def occupancy(self, thresholds: Thresholds | None = None) -> Occupancy:
        """Return the occupancy, cropped to the cells that a beam reached. Raises MapError if there is none.

        It is computed where the counts have changed since the last call.
        """
        thresholds = thresholds or Thresholds()
        if thresholds != self._thresholds:
            self._thresholds, self._changed = thresholds, np.ones_like(self._changed)
        counts, limits = (self._ended, self._passed), (thresholds.occupied, thresholds.free)
        compute_cells(*counts, self._cells, self._changed[: self._used], self._reached, *limits)
        self._changed[:] = False
        if not self._reached.any():
            raise MapError("no beam of any scan hit anything, so there is nothing to draw")
        # contiguous: argwhere returns a transposed array, for which the kernel would be compiled again
        tiles = np.ascontiguousarray(np.argwhere((self._slots >= 0) & self._reached[self._slots]))
        rows, columns = self._extent(tiles, 0), self._extent(tiles, 1)
        cells = np.full((rows.stop - rows.start, columns.stop - columns.start), UNKNOWN, dtype=np.int8)
        copy_tiles(self._cells, self._slots, tiles, rows.start, columns.start, cells)
        origin = self._resolution * (TILE * self._low + np.array([columns.start, rows.start]))
        return Occupancy(cells, origin.astype(np.float64), self._resolution)

    def _extent(self, tiles: Cells, axis: int) -> slice:
        """Return the rows (axis 0) or columns (axis 1) from the first to the last that a beam reached.

        tiles  (n, 2) rows and columns of the tiles that a beam has reached
        """
        first, last = int(tiles[:, axis].min()), int(tiles[:, axis].max())
        begin, end = (self._in_tiles(tiles[tiles[:, axis] == k], axis) for k in (first, last))
        return slice(TILE * first + int(begin[0]), TILE * last + int(end[-1]) + 1)

    def _in_tiles(self, tiles: Cells, axis: int) -> Cells:
        """Return the rows or columns within tiles (n, 2) beside each other that a beam reached."""
        slots = self._slots[tiles[:, 0], tiles[:, 1]]
        reached = (self._ended[slots] + self._passed[slots]).any(axis=0)
        return np.flatnonzero(np.any(reached, axis=1 - axis))


def _with_zeros(array: NDArray[Kind], count: int) -> NDArray[Kind]:
    """Return an array with `count` more rows of zeros, for which the system provides memory when they are used."""
    larger = np.zeros((len(array) + count, *array.shape[1:]), dtype=array.dtype)
    larger[: len(array)] = array
    return larger


@compiled
def compute_cells(ended, passed, cells, changed, reached, occupied, free):  # type: ignore[no-untyped-def]
    """Compute the values of the `cells` (n, TILE, TILE) of the `changed` tiles (n,) from the counts of beams.

    reached         set to True for tiles that a beam has reached, else to False, where they have changed
    occupied, free  thresholds
    """
    for tile in range(len(changed)):
        if not changed[tile]:
            continue
        reached[tile] = False
        for y in range(TILE):
            for x in range(TILE):
                count = ended[tile, y, x] + passed[tile, y, x]
                cells[tile, y, x] = UNKNOWN
                if count > 0:
                    reached[tile] = True
                    share = ended[tile, y, x] / count
                    if share >= occupied:
                        cells[tile, y, x] = OCCUPIED
                    elif share <= free:
                        cells[tile, y, x] = FREE


@compiled
def copy_tiles(cells, slots, tiles, first_row, first_column, picture):  # type: ignore[no-untyped-def]
    """Copy tiles into a picture whose first cell is in a row and a column of the grid; what is outside is left out.

    cells  (m, TILE, TILE) of the slots
    slots  (rows, columns) of the tiles
    tiles  (n, 2) rows and columns of tiles
    """
    for k in range(len(tiles)):
        slot = slots[tiles[k, 0], tiles[k, 1]]
        row, column = TILE * tiles[k, 0] - first_row, TILE * tiles[k, 1] - first_column
        for y in range(max(0, -row), min(TILE, picture.shape[0] - row)):
            for x in range(max(0, -column), min(TILE, picture.shape[1] - column)):
                picture[row + y, column + x] = cells[slot, y, x]


@compiled
def trace_beams(ended, passed, slots, low, start, ends, weight):  # type: ignore[no-untyped-def]
    """Count the beams from `start` (2,) to `ends` (n, 2), in cells, by the algorithm of Amanatides and Woo (1987).

    ended   (m, TILE, TILE) count of the cell that a beam ends in, of the tiles with a slot
    passed  (m, TILE, TILE) counts of the cells that it crosses before
    slots   (rows, columns) of the tiles
    low     (2,) x, y of the first cell of the first tile. It is subtracted from cell indices only: which cell a beam
            ends in must not depend on the extent of the grid
    weight  by which the counts grow: 1, or -1 to remove beams that were counted before
    """
    first_x, first_y = int(np.floor(start[0])), int(np.floor(start[1]))
    for k in range(ends.shape[0]):
        x, y = first_x - low[0], first_y - low[1]
        last_x, last_y = int(np.floor(ends[k, 0])) - low[0], int(np.floor(ends[k, 1])) - low[1]
        step_x = 1 if last_x > x else -1
        step_y = 1 if last_y > y else -1
        left_x, left_y = abs(last_x - x), abs(last_y - y)  # edges still to be crossed
        length_x, length_y = abs(ends[k, 0] - start[0]), abs(ends[k, 1] - start[1])
        # Shares of the beam from one edge to the next in x and y, and from the start to the next edge.
        each_x = 1.0 / length_x if length_x > 0.0 else np.inf
        each_y = 1.0 / length_y if length_y > 0.0 else np.inf
        next_x = abs((first_x + (step_x > 0)) - start[0]) * each_x if left_x else np.inf
        next_y = abs((first_y + (step_y > 0)) - start[1]) * each_y if left_y else np.inf
        while left_x or left_y:
            passed[slots[y // TILE, x // TILE], y % TILE, x % TILE] += weight
            if left_x and (next_x <= next_y or not left_y):
                x += step_x
                left_x -= 1
                next_x += each_x
            else:
                y += step_y
                left_y -= 1
                next_y += each_y
        ended[slots[last_y // TILE, last_x // TILE], last_y % TILE, last_x % TILE] += weight

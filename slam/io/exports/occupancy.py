"""An occupancy grid: how often beams ended in a square cell, and how often they passed through it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ...errors import MapError
from ..tum import Floats
from .placed import PlacedScan

Counts = NDArray[np.int32]
Cells = NDArray[np.int64]

FREE, UNKNOWN, OCCUPIED = 0, -1, 100
"""As in a ROS OccupancyGrid."""
MARGIN = 200
"""Cells by which the grid outgrows what does not fit, so that it does not grow with every scan."""
MOST_CELLS = 400_000_000
"""Of the grid; a building of one kilometre by one at 0.05 m. More is a slip in the resolution, or takes all memory."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Of the beams that reached a cell, the share that ended in it.

    occupied  at least so many and the cell is occupied. A wall that crosses a cell at its edge lets about three
              quarters of the beams pass that go on to its neighbours
    free      at most so many and the cell is free; in between it is unknown
    """

    occupied: float = 0.25
    free: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Occupancy:
    """What is where: `cells` (rows, columns) are FREE, OCCUPIED or UNKNOWN, the first row is the lowest y.

    `origin` (2,) is the corner of the first cell with the least x and y, metres in the map; `resolution` is the side of
    a cell, metres.
    """

    cells: NDArray[np.int8]
    origin: Floats
    resolution: float

    def centres(self, state: int) -> Floats:
        """(n, 2): the middles of the cells in a state, metres in the map."""
        rows, columns = np.nonzero(self.cells == state)
        return np.asarray(self.origin + self.resolution * (np.column_stack([columns, rows]) + 0.5))


class OccupancyGrid:
    """Counts beams in square cells of `resolution` metres, whose edges lie on multiples of it; grows as it has to."""

    def __init__(self, resolution: float) -> None:
        if not 0.0 < resolution < np.inf:
            raise MapError(f"a resolution of {resolution:g} m is not possible")
        self._resolution = resolution
        self._low: Cells = np.zeros(2, dtype=np.int64)  # x, y of the first cell, counted from the map's origin
        self._ended: Counts = np.zeros((0, 0), dtype=np.int32)
        self._passed: Counts = np.zeros((0, 0), dtype=np.int32)

    def add(self, scan: PlacedScan) -> None:
        """Count the beams of a scan. Raises MapError where the grid would become larger than MOST_CELLS."""
        if not len(scan.points):
            return
        start = scan.origin / self._resolution
        ends = scan.points / self._resolution
        corners = np.vstack([start, ends])
        self._make_room(np.floor(corners.min(axis=0)), np.floor(corners.max(axis=0)))
        trace(self._ended, self._passed, self._low, start, ends)

    def add_all(self, scans: Iterable[PlacedScan]) -> int:
        """Count the beams of several scans; how many scans there were."""
        count = 0
        for scan in scans:
            self.add(scan)
            count += 1
        return count

    def _make_room(self, low: Floats, high: Floats) -> None:
        """Let the grid hold the cells from `low` to `high` (2,)."""
        size = np.array(self._ended.shape[::-1])
        below = (self._low - low).astype(np.int64)
        above = (high + 1 - self._low - size).astype(np.int64)
        if not size.any():
            self._low, below, above = low.astype(np.int64), np.zeros(2, np.int64), (high + 1 - low).astype(np.int64)
        if (below <= 0).all() and (above <= 0).all():
            return
        before = np.where(below > 0, below + MARGIN, 0)
        after = np.where(above > 0, above + MARGIN, 0)
        cells = int(np.prod((size + before + after).astype(float)))
        if cells > MOST_CELLS:
            most = f"{MOST_CELLS / 1e6:.0f} million"
            raise MapError(f"cells of {self._resolution:g} m make a grid of more than {most}; make them larger")
        padding = list(zip(before.tolist()[::-1], after.tolist()[::-1], strict=True))
        self._ended, self._passed = np.pad(self._ended, padding), np.pad(self._passed, padding)
        self._low = self._low - before

    def occupancy(self, thresholds: Thresholds | None = None) -> Occupancy:
        """What the beams say, cut to the cells that any beam reached. Raises MapError where none did."""
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


@njit(cache=True)
def trace(ended: Counts, passed: Counts, low: Cells, start: Floats, ends: Floats) -> None:
    """Count each beam from `start` (2,) to `ends` (n, 2), in cells: the cell it ends in, and those it passes before.

    `low` (2,) is the first cell of the counts; where they begin must not decide which cell a beam ends in.

    A beam goes from cell to cell across the edge that it meets next (Amanatides and Woo 1987).
    """
    first_x, first_y = int(np.floor(start[0])), int(np.floor(start[1]))
    for k in range(ends.shape[0]):
        x, y = first_x, first_y
        last_x, last_y = int(np.floor(ends[k, 0])), int(np.floor(ends[k, 1]))
        step_x = 1 if last_x > x else -1
        step_y = 1 if last_y > y else -1
        left_x, left_y = abs(last_x - x), abs(last_y - y)  # edges still to be crossed
        way_x, way_y = abs(ends[k, 0] - start[0]), abs(ends[k, 1] - start[1])
        # Parts of the beam up to the next edge in x and y, and from edge to edge.
        each_x = 1.0 / way_x if way_x > 0.0 else np.inf
        each_y = 1.0 / way_y if way_y > 0.0 else np.inf
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

"""Cells along a wall: those that were observed, and those that scans have seen through.

Cell 0 begins at the frame of the wall. Sets of cells are immutable: a changed set replaces the old one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import Floats
from ..geometry.surroundings import DOOR_WIDTH, SURFACE_DEPTH
from .landmark_table import NEVER_REMOVED

# Metres of wall per cell of coverage. Origin: definition, as ends of walls are not known better.
WALL_CELL = SURFACE_DEPTH
# Metres across a wall within which a point lies on it. Origin: chosen; not measured.
ON_WALL_DISTANCE = 0.15
# Metres between two observed stretches of a wall from which on they are separate pieces: a door or a passage.
# Origin: definition, half a door, as its ends may have errors.
MIN_GAP_BETWEEN_PIECES = 0.5 * DOOR_WIDTH
# Cells by which the end of what was observed of a wall may be wrong, as it is that of a segment, or a sight line has
# passed by: two stretches with no more between them are one, and no more of a wall shows nothing.
# Origin: chosen, 0.2 m; not measured.
END_ERROR_CELLS = 2


def cells_between(low: float, high: float) -> frozenset[int]:
    """Return the cells that lie entirely between two positions along a wall (metres)."""
    return frozenset(range(math.ceil(low / WALL_CELL), math.floor(high / WALL_CELL)))


def observed_cells(frame: se2.Pose, half_length: float, along: float, points: Floats) -> frozenset[int]:
    """Return the cells of a wall that a scan observed.

    A line is also fitted across a door, at grazing incidence even without a beam through it. So cells between two
    neighbouring points farther apart than MIN_GAP_BETWEEN_PIECES were not observed, nor is that of a point alone: it
    may be on a leaf of the door, or between two surfaces.

    frame   of the segment in the map, at its centre, which is `along` metres from the frame of the wall
    points  (p, 2) of the scan, in the map
    """
    first = math.ceil((along - half_length) / WALL_CELL)
    observed = _observed(np.ascontiguousarray(points), frame, half_length, WALL_CELL * first - along)
    return frozenset((first + observed.nonzero()[0]).tolist())


@compiled
def _observed(points, frame, half, start):  # type: ignore[no-untyped-def]
    """Return which cells between the ends of a segment were observed; the first begins at `start` from its centre."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    positions = np.empty(len(points) + 2)
    positions[0], positions[1], count = -half, half, 2
    for k in range(len(points)):
        x, y = points[k, 0] - frame[0], points[k, 1] - frame[1]
        along = c * x + s * y
        if abs(c * y - s * x) < ON_WALL_DISTANCE and abs(along) < half:
            positions[count] = along
            count += 1
    positions = np.sort(positions[:count])
    observed = np.zeros(max(0, math.floor((half - start) / WALL_CELL)), dtype=np.bool_)
    first = 0
    for k in range(1, count + 1):
        if k < count and positions[k] - positions[k - 1] <= MIN_GAP_BETWEEN_PIECES:
            continue
        if k - first > 1:
            begin = max(0, math.floor((positions[first] - start) / WALL_CELL))
            observed[begin : max(begin, math.ceil((positions[k - 1] - start) / WALL_CELL))] = True
        first = k
    return observed


def pieces_of(covered: Sequence[frozenset[int]], low: Floats, high: Floats) -> list[Floats]:
    """Return for each of n walls (k, 2) the stretches of covered cells, begin and end in metres along its frame.

    covered    n sets of cells
    low, high  (n,) ends of the walls, metres: the outermost ends of the stretches, unless a gap is next to them

    Gaps of up to MIN_GAP_BETWEEN_PIECES metres do not divide a wall.
    """
    counts = np.array([len(cells) for cells in covered], dtype=np.int64)
    wall = np.repeat(np.arange(len(covered)), counts)
    cells = np.fromiter(chain.from_iterable(covered), dtype=np.int64, count=len(wall))
    cells = cells[np.lexsort((cells, wall))]
    low, high, last = low.copy(), high.copy(), np.cumsum(counts) - 1
    seen = np.flatnonzero(counts)
    begin, end = WALL_CELL * cells[last[seen] - counts[seen] + 1], WALL_CELL * (cells[last[seen]] + 1)
    low[seen] = np.where(begin - low[seen] > MIN_GAP_BETWEEN_PIECES, begin, low[seen])
    high[seen] = np.where(high[seen] - end > MIN_GAP_BETWEEN_PIECES, end, high[seen])
    breaks = np.flatnonzero((np.diff(wall) == 0) & (np.diff(cells) > MIN_GAP_BETWEEN_PIECES / WALL_CELL))
    ends = np.cumsum(1 + np.bincount(wall[breaks], minlength=len(covered))).tolist()
    begins = [0, *ends][:-1]
    pieces = np.empty((len(covered) + len(breaks), 2))
    inner = np.ones((len(pieces), 2), dtype=bool)
    inner[begins, 0] = inner[np.array(ends, dtype=np.int64) - 1, 1] = False
    pieces[~inner[:, 0], 0], pieces[~inner[:, 1], 1] = low, high
    pieces[inner[:, 0], 0], pieces[inner[:, 1], 1] = WALL_CELL * cells[breaks + 1], WALL_CELL * (cells[breaks] + 1)
    return [pieces[first:end] for first, end in zip(begins, ends, strict=True)]


def trimmed(covered: frozenset[int], low: float, high: float) -> tuple[float, float]:
    """Return the ends of a wall (metres), moved to within a cell of its outermost covered cells, if it has any."""
    if not covered:
        return low, high
    return max(low, WALL_CELL * (min(covered) - 1)), min(high, WALL_CELL * (max(covered) + 2))


def cells_of(points: Floats) -> frozenset[int]:
    """Return the cells on which points (p, 2), in the wall's frame, lie."""
    on_wall = np.abs(points[:, 1]) < ON_WALL_DISTANCE
    return frozenset(np.floor(points[on_wall, 0] / WALL_CELL).astype(np.int64).tolist())


def still_covered(cells: Iterable[int], opened: Mapping[int, int], keyframe: int) -> frozenset[int]:
    """Return the cells, observed by a keyframe, without those opened at this keyframe or later.

    opened  opened cells, and the keyframe after which each was no longer there
    """
    return frozenset(cell for cell in cells if opened.get(cell, NEVER_REMOVED) < keyframe)


def latest_openings(first: Mapping[int, int], second: Mapping[int, int]) -> dict[int, int]:
    """Return the opened cells of two walls that are one, with the later keyframe if both have a cell."""
    return {
        cell: max(first.get(cell, NEVER_REMOVED), second.get(cell, NEVER_REMOVED))
        for cell in first.keys() | second.keys()
    }

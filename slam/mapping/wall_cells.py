"""Cells along a wall: those that were observed, and those that scans have seen through.

Cell 0 begins at the frame of the wall. Sets of cells are immutable: a changed set replaces the old one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from ..geometry.segments import Floats
from .landmark_table import NEVER_REMOVED

# Metres of wall per cell of coverage. Origin: chosen, finer than a door or a pillar; not measured.
WALL_CELL = 0.1
# Metres across a wall within which a point lies on it. Origin: chosen, half of MIN_DEPTH of sight lines; not measured.
ON_WALL_DISTANCE = 0.15
# Metres between two observed stretches of a wall from which on they are separate pieces: a door or a passage.
# Origin: chosen, less than the width of a door; not measured.
MIN_GAP_BETWEEN_PIECES = 0.5


def cells_between(low: float, high: float) -> frozenset[int]:
    """Return the cells that lie entirely between two positions along a wall (metres)."""
    return frozenset(range(math.ceil(low / WALL_CELL), math.floor(high / WALL_CELL)))


def pieces_of(covered: frozenset[int], low: float, high: float) -> Floats:
    """Return (k, 2) the stretches of covered cells, begin and end in metres along the wall's frame.

    low, high  ends of the wall, metres: they are the outermost ends of the stretches

    Gaps of up to MIN_GAP_BETWEEN_PIECES metres do not divide a wall.
    """
    cells = np.sort(np.fromiter(covered, dtype=np.int64, count=len(covered)))
    breaks = np.flatnonzero(np.diff(cells) > MIN_GAP_BETWEEN_PIECES / WALL_CELL)
    begin = np.concatenate([[low], WALL_CELL * cells[breaks + 1]])
    end = np.concatenate([WALL_CELL * (cells[breaks] + 1), [high]])
    return np.column_stack([begin, end])


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
    """Return those of some cells that a keyframe observed which were not opened then or later.

    opened  opened cells, and the keyframe after which each was no longer there
    """
    return frozenset(cell for cell in cells if opened.get(cell, NEVER_REMOVED) < keyframe)


def latest_openings(first: Mapping[int, int], second: Mapping[int, int]) -> dict[int, int]:
    """Return the opened cells of two walls that are one, with the later keyframe if both have a cell."""
    return {
        cell: max(first.get(cell, NEVER_REMOVED), second.get(cell, NEVER_REMOVED))
        for cell in first.keys() | second.keys()
    }

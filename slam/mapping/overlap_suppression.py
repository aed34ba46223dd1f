"""One wall where what is seen of it lies on several lines.

A wall with door frames, pillars and ledges is seen as one line or another, as one looks at it: too far apart for their
covariances to be one landmark, too close to be two walls. The estimate keeps them apart, which costs it nothing. On the
map that would be a wall drawn twice. But no wall can be seen through another: of two that face alike, one a few
centimetres behind the other, only one is there. So on the map each stretch is the wall's that was seen most often.
"""

from __future__ import annotations

import copy
import math

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Integers
from .landmarks import WALL_CELL, Landmarks

DEPTH = 0.05  # metres by which a wall's frames, pillars and ledges may stand out: the bays of a facade are deeper
ALIKE = math.radians(10.0)  # by which the lines may be turned against each other
# Cells in a row that are hidden, or that are left: walls that meet at a blunt angle lie side by side for a while, too.
LEAST_CELLS = 3


def suppress_overlapping_walls(landmarks: Landmarks) -> Landmarks:
    """The landmarks as a map shows them: each stretch along which several confirmed walls were seen given to one, which
    speaks for those of which nothing is left."""
    shown = copy.deepcopy(landmarks)
    rows = shown.walls.rows
    walls = np.flatnonzero(rows["in_graph"] & shown.active())
    ranked = walls[np.lexsort((walls, -rows["observations"][walls]))]
    for wall, others in _alongside(rows[ranked], ranked).items():  # what stands before a wall is final
        behind = {other: _behind(shown, wall, other) for other in others if rows["merged_into"][other] == other}
        if not any(behind.values()):
            continue
        left = _runs(shown.covered[wall].difference(*behind.values()))
        shown.covered[wall] = left
        if left:
            shown.trim_extent(wall)
        else:
            rows["merged_into"][rows["merged_into"] == wall] = max(behind, key=lambda other: len(behind[other]))
    return shown


def _alongside(rows: NDArray[np.void], walls: Integers) -> dict[int, list[int]]:
    """For each of the walls (n,) those before it that run along it, facing alike."""
    along, across, turn = np.moveaxis(se2.between(rows["frame"][:, None], rows["frame"][None, :]), -1, 0)
    reach = np.maximum(-rows["low"], rows["high"])
    near = (along - reach < rows["high"][:, None]) & (along + reach > rows["low"][:, None])
    near &= np.abs(across) < DEPTH + (reach + np.abs(along)) * math.sin(ALIKE)
    found: dict[int, list[int]] = {}
    for later, earlier in np.argwhere(np.tril(near & (np.abs(turn) < ALIKE), -1)):
        found.setdefault(int(walls[later]), []).append(int(walls[earlier]))
    return found


def _behind(landmarks: Landmarks, wall: int, other: int) -> frozenset[int]:
    """The cells of a wall where another one was seen a little before or behind it."""
    frames = landmarks.walls.rows["frame"]
    cells = np.fromiter(landmarks.covered[wall], dtype=np.int64, count=len(landmarks.covered[wall]))
    middles = np.column_stack([WALL_CELL * (cells + 0.5), np.zeros(len(cells))])
    seen = se2.transform(se2.between(frames[other], frames[wall]), middles).reshape(-1, 2)
    also = np.isin(np.floor(seen[:, 0] / WALL_CELL), list(landmarks.covered[other]))
    return _runs(frozenset(cells[also & (np.abs(seen[:, 1]) < DEPTH)].tolist()))


def _runs(cells: frozenset[int]) -> frozenset[int]:
    """Those of the cells that are LEAST_CELLS in a row or more."""
    ordered = np.array(sorted(cells), dtype=np.int64)
    rows = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
    return frozenset(cell for row in rows if len(row) >= LEAST_CELLS for cell in row.tolist())

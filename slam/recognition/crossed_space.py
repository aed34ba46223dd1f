"""Space that the beams of a map have crossed, with a finer resolution than the seen cells of a distance field.

A point of another map on no known surface contradicts this map only there: at the end of what was seen of a wall, a
beam has been near the rest of it, and has not passed through.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled, inlined
from drivers.immutable import immutable

from ..geometry.segments import Floats
from ..matching.free_space import NEW_SURFACE


@immutable
class CrossedSpace:
    """Grid of square cells with sides of NEW_SURFACE.

    corner   (2,) of the grid, metres
    crossed  (n, m) 1 if a beam crossed the cell and ended farther behind it than NEW_SURFACE
    """

    corner: Floats
    crossed: NDArray[np.uint8]

    @classmethod
    def of_beams(cls, starts: Floats, ends: Floats) -> CrossedSpace:
        """Return the space that beams from `starts` to `ends`, both (p, 2), have crossed."""
        every = np.concatenate([starts, ends]) if len(ends) else np.zeros((1, 2))
        corner = every.min(axis=0)
        rows, columns = ((every.max(axis=0) - corner) / NEW_SURFACE).astype(np.int64) + 1
        crossed = np.zeros((rows, columns), dtype=np.uint8)
        _mark_crossed(corner, crossed, np.ascontiguousarray(starts), np.ascontiguousarray(ends))
        return cls(corner, crossed)

    @property
    def arrays(self) -> tuple[Floats, NDArray[np.uint8]]:
        """Arrays for compiled functions."""
        return self.corner, self.crossed


@compiled
def _mark_crossed(corner, crossed, starts, ends):  # type: ignore[no-untyped-def]
    """Mark the cells that beams from `starts` to `ends`, both (p, 2), cross."""
    for k in range(len(ends)):
        x, y = (starts[k, 0] - corner[0]) / NEW_SURFACE, (starts[k, 1] - corner[1]) / NEW_SURFACE
        along_x, along_y = (ends[k, 0] - starts[k, 0]) / NEW_SURFACE, (ends[k, 1] - starts[k, 1]) / NEW_SURFACE
        length = math.hypot(along_x, along_y) - 1.0  # in cells, up to where the surface that it hits may begin
        steps = int(1.5 * max(abs(along_x), abs(along_y))) + 1
        for step in range(steps):
            share = step / steps
            if share * (length + 1.0) > length:
                break
            crossed[int(x + share * along_x), int(y + share * along_y)] = 1


@inlined
def is_crossed(space, x, y):  # type: ignore[no-untyped-def]
    """Return True if beams have crossed the cell of (x, y), metres, and all its neighbours."""
    corner, crossed = space
    row, column = math.floor((x - corner[0]) / NEW_SURFACE), math.floor((y - corner[1]) / NEW_SURFACE)
    if row < 1 or column < 1 or row >= crossed.shape[0] - 1 or column >= crossed.shape[1] - 1:
        return False
    for i in range(row - 1, row + 2):
        for j in range(column - 1, column + 2):
            if crossed[i, j] == 0:
                return False
    return True

"""Sparse grids of offsets: vectors from the nearest point to each cell, stored in tiles where there are points nearby.

Points lie on surfaces, so most cells of a grid are far from all of them: a field of a building fills a sixth of its
tiles. Cells near each other are also near each other in memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import inlined

# Metres, side of a cell. Origin: chosen, the noise of usual lidars; distances are interpolated between cells.
FIELD_CELL = 0.05
# Metres: larger distances are not stored. It is also how far a pose may be off for Gauss-Newton to correct it.
# Origin: chosen, about the width of a corridor's furniture; not measured.
MAX_DISTANCE = 0.5
# Cells on each side of a point's cell to which it is the nearest one at most. Origin: definition.
SPAN = round(MAX_DISTANCE / FIELD_CELL)
# Metres, unit of stored offsets. Origin: numerical, 16 bits hold more than MAX_DISTANCE with it.
OFFSET_UNIT = 1e-4
UNITS_PER_METRE = 1e4  # Origin: definition, the inverse of OFFSET_UNIT.
# Square of MAX_DISTANCE in squared units. Origin: definition.
MAX_SQUARED = round((MAX_DISTANCE * UNITS_PER_METRE) ** 2)
# Offset along both axes where there is no point. Origin: numerical, the largest number of 16 bits.
NOWHERE = 32767
# The same as a stored offset. Origin: definition, see `OffsetTiles`.
NO_OFFSET = NOWHERE << 16 | NOWHERE
# Binary logarithm of the cells on each side of a tile. Origin: measured, tiles of 16 cells are entered in half the time
# of tiles of 8 cells, and take a quarter less memory than tiles of 32 cells.
TILE_BITS = 4
TILE = 1 << TILE_BITS  # Origin: definition.


@dataclass(slots=True, eq=False)
class OffsetTiles:
    """Several grids of the same size, in square tiles of TILE x TILE cells.

    tile_of  (g, t, t) number of the tile of each grid; 0, a tile without points, where nothing was entered
    tiles    (n, TILE, TILE) offset from the nearest point to the cell's centre in units of OFFSET_UNIT, NO_OFFSET if
             there is none within MAX_DISTANCE: the upper 16 bits along x, the lower 16 along y, both signed
    count    number of tiles in use; the others have any values
    """

    tile_of: NDArray[np.int32]
    tiles: NDArray[np.int32]
    count: int

    @classmethod
    def empty(cls, grids: int, cells: int) -> OffsetTiles:
        """Return grids of at least `cells` x `cells` without points."""
        side = -(-cells // TILE)
        return cls(np.zeros((grids, side, side), dtype=np.int32), _empty_tiles(1), 1)

    def copy(self) -> OffsetTiles:
        """Return an independent copy."""
        return OffsetTiles(self.tile_of.copy(), self.tiles[: self.count].copy(), self.count)

    def grow(self, count: int) -> None:
        """Make room for `count` tiles in all."""
        if count > len(self.tiles):
            tiles = np.empty((max(count, 2 * self.count), TILE, TILE), dtype=np.int32)  # no memory until it is written
            tiles[: self.count] = self.tiles[: self.count]
            self.tiles = tiles
        self.tiles[self.count : count] = NO_OFFSET
        self.count = count


def _empty_tiles(count: int) -> NDArray[np.int32]:
    return np.full((count, TILE, TILE), NO_OFFSET, dtype=np.int32)


@inlined
def number_tiles(tile_of, count, grid, row, column):  # type: ignore[no-untyped-def]
    """Number the tiles that a point in a cell changes and that have no number yet; return the number of tiles then."""
    for i in range((row - SPAN) >> TILE_BITS, ((row + SPAN) >> TILE_BITS) + 1):
        for j in range((column - SPAN) >> TILE_BITS, ((column + SPAN) >> TILE_BITS) + 1):
            if tile_of[grid, i, j] == 0:
                tile_of[grid, i, j] = count
                count += 1
    return count


@inlined
def offset_at(tile_of, tiles, grid, row, column):  # type: ignore[no-untyped-def]
    """Return the stored offset of a cell. Unsigned indices take half the time: nothing tests if they are negative."""
    tile = tile_of[np.uintp(grid), np.uintp(row >> TILE_BITS), np.uintp(column >> TILE_BITS)]
    return tiles[np.uintp(tile), np.uintp(row & (TILE - 1)), np.uintp(column & (TILE - 1))]


@inlined
def metres(offset):  # type: ignore[no-untyped-def]
    """Return a stored offset as a vector (metres), more than MAX_DISTANCE long if there is none."""
    return OFFSET_UNIT * (offset >> 16), OFFSET_UNIT * (np.int32(offset << 16) >> 16)


@inlined
def enter_point(tile_of, tiles, grid, x, y):  # type: ignore[no-untyped-def]
    """Enter the offsets from a point at (x, y), in cells, into the cells around it. Their tiles must be numbered."""
    top, left = round(x) - SPAN, round(y) - SPAN  # cells before, and 2 SPAN cells on, are all beyond MAX_DISTANCE
    for i in range(top >> TILE_BITS, ((top + 2 * SPAN - 1) >> TILE_BITS) + 1):
        first, last = max(0, top - i * TILE), min(TILE, top + 2 * SPAN - i * TILE)
        for j in range(left >> TILE_BITS, ((left + 2 * SPAN - 1) >> TILE_BITS) + 1):
            _enter_into_tile(tiles, tile_of[grid, i, j], first, last, x - i * TILE, y - j * TILE)


@inlined
def _enter_into_tile(tiles, tile, first, last, x, y):  # type: ignore[no-untyped-def]
    """Enter the offsets from a point at (x, y), in cells of the tile, into its rows from `first` to before `last`.

    There is no branch for each cell, and squares are integers of 32 bits, so that many cells are computed at once.
    """
    for i in range(first, last):
        dx = FIELD_CELL * (i + 0.5 - x) * UNITS_PER_METRE
        upper = round(dx) << 16
        for j in range(TILE):
            stored = tiles[tile, i, j]
            old_x, old_y = np.int32(stored >> 16), np.int32(np.int32(stored << 16) >> 16)
            old = np.int32(np.int32(old_x * old_x) + np.int32(old_y * old_y))
            dy = FIELD_CELL * (j + 0.5 - y) * UNITS_PER_METRE
            squared = np.int32(dx * dx + dy * dy)
            offset = np.int32(upper | (np.int32(np.rint(dy)) & 0xFFFF))
            tiles[tile, i, j] = offset if (squared < MAX_SQUARED) & (squared < old) else stored

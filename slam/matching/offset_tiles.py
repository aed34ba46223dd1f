"""Sparse grids of offsets: vectors from the nearest point to each cell, stored in tiles where there are points nearby.

Points lie on surfaces, so most cells of a grid are far from all of them: a field of a building fills a sixth of its
tiles. Cells near each other are also near each other in memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import inlined
from features.normal_limits import NORMAL_LIMIT

from ..geometry.surroundings import SURFACE_DEPTH

# Metres, side of a cell; distances are interpolated between cells. Origin: definition, two cells between surfaces.
FIELD_CELL = 0.5 * SURFACE_DEPTH
# Metres: larger distances are not stored. It is also how far a pose may be off for Gauss-Newton to correct it.
# Origin: chosen, about the width of a corridor's furniture; not measured.
MAX_DISTANCE = 0.5
# Radians that a pose may be turned for Gauss-Newton to correct it. Origin: definition, MAX_DISTANCE at 4 m.
MAX_TURN = MAX_DISTANCE / 4.0
# Metres and radians, standard deviations up to which a pose is that near. Origin: definition.
MAX_CORRECTED_SIGMA, MAX_CORRECTED_TURN_SIGMA = MAX_DISTANCE / NORMAL_LIMIT, MAX_TURN / NORMAL_LIMIT
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
# Tiles of a grid in which the 2 SPAN cells around a point are, at most. Origin: definition.
TILES_OF_POINT = ((2 * SPAN - 2) // TILE + 2) ** 2
# Tiles for which there is room at first. Origin: measured, half of what a field around a robot in a building has.
MIN_ROOM = 1024
# Cells from a new point to the place for which the second known point is looked up that limits its cells.
# Origin: measured, of 2, 3 and 4 cells the least time.
BEYOND = 3.0
# Squared cells by which the distances of a cell from two points must differ, as offsets are rounded.
# Origin: numerical, twice the sum of both distances, SPAN at most, times the unit of offsets in cells.
ROUNDING = 0.25
# Cells; a smaller component of a vector between points does not limit the cells. Origin: numerical.
MIN_COMPONENT = 1e-3


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

    def clear(self) -> None:
        """Remove all points. The memory is kept: to get it again from the system takes longer than to fill it."""
        self.tile_of.fill(0)
        self.count = 1

    def copy(self) -> OffsetTiles:
        """Return an independent copy."""
        return OffsetTiles(self.tile_of.copy(), self.tiles[: self.count].copy(), self.count)

    def trim(self) -> None:
        """Return the memory of unused tiles, without copying the others. No tile can be entered any more."""
        self.tiles.resize((self.count, TILE, TILE), refcheck=False)

    def grow(self) -> None:
        """Make room for as many tiles again."""
        room = max(MIN_ROOM, 2 * len(self.tiles))
        tiles = np.empty((room, TILE, TILE), dtype=np.int32)  # no memory until it is written
        tiles[: self.count] = self.tiles[: self.count]
        self.tiles = tiles


def _empty_tiles(count: int) -> NDArray[np.int32]:
    return np.full((count, TILE, TILE), NO_OFFSET, dtype=np.int32)


@inlined
def offset_at(tile_of, tiles, grid, row, column):  # type: ignore[no-untyped-def]
    """Return the stored offset of a cell, at a row and a column of a grid; for the arrays see `OffsetTiles`.

    Unsigned indices take half the time: nothing tests if they are negative.
    """
    tile = tile_of[np.uintp(grid), np.uintp(row >> TILE_BITS), np.uintp(column >> TILE_BITS)]
    return tiles[np.uintp(tile), np.uintp(row & (TILE - 1)), np.uintp(column & (TILE - 1))]


@inlined
def metres(offset):  # type: ignore[no-untyped-def]
    """Return a stored offset as a vector (metres), more than MAX_DISTANCE long if there is none."""
    return OFFSET_UNIT * (offset >> 16), OFFSET_UNIT * (np.int32(offset << 16) >> 16)


@inlined
def squared_length(offset):  # type: ignore[no-untyped-def]
    """Return the squared length of a stored offset in squared units, more than MAX_SQUARED if there is none."""
    dx, dy = np.int32(offset >> 16), np.int32(np.int32(offset << 16) >> 16)
    return np.int32(np.int32(dx * dx) + np.int32(dy * dy))


@inlined
def enter_point(tile_of, tiles, count, grid, x, y):  # type: ignore[no-untyped-def]
    """Enter the offsets from a point at (x, y), in cells, into the cells around it that it may be the nearest one of.

    `count` is the number of tiles, that with the new ones is returned. There must be room for TILES_OF_POINT more.

    Two known points limit these cells: the nearest one, and that nearest to a place beyond the new point, as a point of
    a wall has neighbours on either side.
    """
    near_x, near_y = _from_nearest(tile_of, tiles, grid, x, y, x, y)
    distance, far_x, far_y = math.sqrt(near_x * near_x + near_y * near_y), 0.0, 0.0  # hypot takes longer
    if distance > 0.0:
        beyond_x, beyond_y = x + BEYOND * near_x / distance, y + BEYOND * near_y / distance
        far_x, far_y = _from_nearest(tile_of, tiles, grid, x, y, beyond_x, beyond_y)
    top, left = round(x) - SPAN, round(y) - SPAN  # cells before, and 2 SPAN cells on, are all beyond MAX_DISTANCE
    for j in range(left >> TILE_BITS, ((left + 2 * SPAN - 1) >> TILE_BITS) + 1):
        begin, end = max(j * TILE, left) + 0.5 - y, min((j + 1) * TILE, left + 2 * SPAN) - 0.5 - y
        gap = max(begin, -end, 0.0)
        reach = math.sqrt(max(0.0, SPAN * SPAN - gap * gap))
        low, high = _limit(-reach, reach, begin, end, near_x, near_y)
        low, high = _limit(low, high, begin, end, far_x, far_y)
        first, last = max(top, math.floor(x + low)), min(top + 2 * SPAN, math.floor(x + high) + 1)
        if first >= last:
            continue
        for i in range(first >> TILE_BITS, ((last - 1) >> TILE_BITS) + 1):
            if tile_of[grid, i, j] == 0:
                tile_of[grid, i, j] = count
                tiles[count] = NO_OFFSET
                count += 1
            rows = max(0, first - i * TILE), min(TILE, last - i * TILE)
            _enter_into_tile(tiles, tile_of[grid, i, j], rows[0], rows[1], x - i * TILE, y - j * TILE)
    return count


@inlined
def _from_nearest(tile_of, tiles, grid, x, y, at_x, at_y):  # type: ignore[no-untyped-def]
    """Return the vector to (x, y) from the known point nearest to the cell of another place; zero without one."""
    row, column = math.floor(at_x), math.floor(at_y)
    offset = offset_at(tile_of, tiles, grid, row, column)
    if offset == NO_OFFSET:
        return 0.0, 0.0
    dx, dy = metres(offset)
    return x - (row + 0.5 - dx / FIELD_CELL), y - (column + 0.5 - dy / FIELD_CELL)


@inlined
def _limit(low, high, begin, end, dx, dy):  # type: ignore[no-untyped-def]
    """Limit rows of cells from `low` to `high` to those with cells that are nearer to a new point than to a known one.

    The cells of a row are those from `begin` to `end`, all relative to the new point. If d = (dx, dy) is the vector to
    it from the known point, the cells v that are nearer to it are those with v . d > -d . d / 2.
    """
    least = -0.5 * (dx * dx + dy * dy + ROUNDING) - max(begin * dy, end * dy)
    if abs(dx) < MIN_COMPONENT:
        return low, high
    return (max(low, least / dx), high) if dx > 0.0 else (low, min(high, least / dx))


@inlined
def _enter_into_tile(tiles, tile, first, last, x, y):  # type: ignore[no-untyped-def]
    """Enter the offsets from a point at (x, y), in cells of the tile, into its rows from `first` to before `last`.

    There is no branch for each cell, and squares are integers of 32 bits, so that many cells are computed at once. If
    nothing were done with the chosen offsets, LLVM would store only those that change, by masked stores, which are
    slower. So the exclusive or with zero is stored, which only the empty tile shows to be 0.
    """
    t, zero = np.uintp(tile), np.int32(tiles[0, 0, 0] ^ NO_OFFSET)
    for i in range(first, last):
        dx = FIELD_CELL * (i + 0.5 - x) * UNITS_PER_METRE
        upper = round(dx) << 16
        for j in range(TILE):
            stored = tiles[t, np.uintp(i), np.uintp(j)]
            old = squared_length(stored)
            dy = FIELD_CELL * (j + 0.5 - y) * UNITS_PER_METRE
            squared = np.int32(dx * dx + dy * dy)
            offset = np.int32(upper | (np.int32(np.rint(dy)) & 0xFFFF))
            nearest = offset if (squared < MAX_SQUARED) & (squared < old) else stored
            tiles[t, np.uintp(i), np.uintp(j)] = np.int32(nearest ^ zero)

"""Distance field: the vector from the nearest scan point to each cell of a grid, and which cells were seen.

A scan is matched to it with all its points, whatever they belong to. Points are inserted one scan at a time, so the
field grows with the drive; `LocalField` replaces it when the robot leaves its middle, or when the map is corrected.
Points that appear in free space enter it when some scans in a row have seen them.

A wall has two faces some centimetres apart, and a robot that drives past it sees first one and then the other. To match
one with the other would shift the pose by the wall's thickness. So there is one grid for each direction that a surface
faces, and one for all points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled, inlined
from drivers.immutable import immutable

from ..geometry.segments import Floats
from .free_space import (
    APPEARED,
    HELD,
    IN_UNSEEN_SPACE,
    KNOWN,
    NEW,
    NEW_SURFACE,
    OUTSIDE,
    SEEN_CELL,
    SEEN_CELLS,
    WaitingPoints,
    add_sighting,
    hold_lines,
    is_surrounded,
    mark_seen,
)
from .offset_tiles import (
    FIELD_CELL,
    MAX_DISTANCE,
    SPAN,
    TILES_OF_POINT,
    OffsetTiles,
    enter_point,
    metres,
    offset_at,
)

# Metres from the middle to each side. Origin: chosen, the range of usual indoor lidars; farther points are not used.
FIELD_HALF_WIDTH = 30.0
# Cosine between a surface's normal and a direction up to which the surface belongs to it. Origin: definition, 67.5
# degrees: a surface belongs to the nearest of the four directions, and to the second one if it is nearly as near.
MIN_FACING = math.cos(math.radians(67.5))
# Number of the grid of all points, after those of surfaces that face along x, y, -x and -y. Origin: definition.
ALL_POINTS = 4
# Metres from an inserted point within which another point adds nothing. Origin: definition, half a cell's diagonal.
SAME_POINT = FIELD_CELL / math.sqrt(2.0)


Arrays = tuple[Floats, NDArray[np.int32], NDArray[np.int32], NDArray[np.uint8]]
"""Arrays of a field for compiled functions: origin, numbers of the tiles, tiles, seen cells."""


@immutable
class DistanceField:
    """Square grids around a place of the map.

    A point xy is in the row and the column floor((xy - origin) / side), with the side of a cell: FIELD_CELL of the
    offsets, and SEEN_CELL of `seen`.

    origin   (2,) corner of the grids in the map, metres
    offsets  five grids of vectors from the nearest point to the cell's centre: one for the surfaces that face along
             each of x, y, -x, -y, and one for all points
    seen     (s, s) 1 if a beam crossed the cell or ended in it
    waiting  points in free space that few scans have seen; see `free_space`
    """

    origin: Floats
    offsets: OffsetTiles
    seen: NDArray[np.uint8]
    waiting: WaitingPoints

    @classmethod
    def empty(cls, centre: Floats, half_width: float = FIELD_HALF_WIDTH) -> DistanceField:
        """Return a field around `centre` (2,) without points."""
        side = int(2 * half_width / SEEN_CELL)
        offsets, seen = OffsetTiles.empty(ALL_POINTS + 1, SEEN_CELLS * side), np.zeros((side, side), dtype=np.uint8)
        return cls(_origin(centre, half_width), offsets, seen, WaitingPoints.empty(side))

    def cleared(self, centre: Floats) -> DistanceField:
        """Return an empty field around `centre` (2,) in the memory of this one, which is not valid any more."""
        self.offsets.clear()
        self.seen.fill(0)
        self.waiting.clear()
        origin = _origin(centre, 0.5 * len(self.seen) * SEEN_CELL)
        return DistanceField(origin, self.offsets, self.seen, self.waiting)

    def completed(self) -> DistanceField:
        """Return the field in as little memory as it needs to be matched with: no scan can be inserted any more.

        It takes the memory of this one, which is not valid any more.
        """
        self.offsets.trim()
        return DistanceField(self.origin, self.offsets, self.seen, WaitingPoints.empty(0))

    def __deepcopy__(self, memo: dict[int, object]) -> DistanceField:
        """Return an independent copy."""
        return DistanceField(self.origin, self.offsets.copy(), self.seen.copy(), self.waiting.copy())

    @property
    def arrays(self) -> Arrays:
        """Arrays for compiled functions."""
        return self.origin, self.offsets.tile_of, self.offsets.tiles, self.seen

    def insert(self, pose: se2.Pose, points: Floats) -> None:
        """Insert a scan's points (p, 6) with normals that face the lidar, given in the frame of the base at `pose`.

        A point whose normal is zero, or not given (p, 2), may face in any direction. Points outside the field only mark
        the cells that their beams cross as seen.
        """
        if points.shape[1] == 2:
            points = np.column_stack([points, np.zeros_like(points)])
        self.insert_scans(np.asarray(pose, dtype=np.float64)[None], [points])

    def insert_scans(self, poses: Floats, scans: Sequence[NDArray[np.floating]]) -> None:
        """Insert the points (p, 6), with normals, of several scans, one after the other; see `insert`."""
        if not len(scans):
            return
        points, first, entered = np.concatenate(scans, dtype=np.float64), np.cumsum([0, *map(len, scans)]), 0
        kinds = np.zeros(len(points), dtype=np.uint8)
        while entered < len(points):
            self.offsets.count, entered = _insert(
                self.arrays, self.waiting.cells, self.waiting.scans, self.offsets.count,
                poses, points, kinds, first, entered,
            )  # fmt: skip
            if entered < len(points):
                self.offsets.grow()
        self.waiting.scans += len(scans)

    @property
    def centre(self) -> Floats:
        """Middle of the field (2,), metres."""
        return np.asarray(self.origin + 0.5 * len(self.seen) * SEEN_CELL)

    def centre_distance(self, position: Floats) -> float:
        """Return the larger distance (metres) along the axes of a position (2,) from the middle of the field."""
        return float(np.abs(position[:2] - self.centre).max())


def _origin(centre: Floats, half_width: float) -> Floats:
    """Return the corner (2,) of the grids of a field, metres."""
    return np.asarray(np.floor((np.asarray(centre[:2]) - half_width) / SEEN_CELL) * SEEN_CELL)


@compiled
def _insert(field, waiting, scans, count, poses, points, kinds, first, begin):  # type: ignore[no-untyped-def]
    """Enter the offsets from each point into the cells around it, and mark the cells between it and the robot.

    The points of scan j, from `first[j]` to before `first[j + 1]`, are in the frame of `poses[j]`. Those before `begin`
    have been entered. The points of a scan are compared with the field before any of them enters it, and the cells that
    its beams cross are marked afterwards. Returns the number of tiles, of which there were `count`, and the first point
    that is not entered as there may be no room for its tiles.

    waiting, scans  see `WaitingPoints`
    kinds           (p,) kinds of the points of the scan to which `begin` belongs, see `free_space`; overwritten
    """
    origin, tile_of, tiles, seen = field
    for j in range(len(poses)):
        if begin >= first[j + 1]:
            continue
        c, s = math.cos(poses[j, 2]), math.sin(poses[j, 2])
        start_x, start_y = (poses[j, 0] - origin[0]) / FIELD_CELL, (poses[j, 1] - origin[1]) / FIELD_CELL
        if begin <= first[j]:
            own = slice(first[j], first[j + 1])
            _find_kinds(field, waiting, scans + j + 1, start_x, start_y, c, s, points[own], kinds[own])
            hold_lines(points[own], kinds[own])
        for k in range(max(begin, first[j]), first[j + 1]):
            if count + (ALL_POINTS + 1) * TILES_OF_POINT > len(tiles):
                return count, k
            x = start_x + (c * points[k, 0] - s * points[k, 1]) / FIELD_CELL
            y = start_y + (s * points[k, 0] + c * points[k, 1]) / FIELD_CELL
            if kinds[k] == OUTSIDE or kinds[k] & HELD:
                continue
            if kinds[k] == NEW and nearest_distance(field, ALL_POINTS, x, y) >= NEW_SURFACE:
                continue
            normal_x, normal_y = c * points[k, 2] - s * points[k, 3], s * points[k, 2] + c * points[k, 3]
            for grid in range(ALL_POINTS + 1):
                if belongs_to(grid, normal_x, normal_y) and not _is_known(tile_of, tiles, grid, x, y):
                    count = enter_point(tile_of, tiles, count, grid, x, y)
        for k in range(first[j], first[j + 1]):
            x = start_x + (c * points[k, 0] - s * points[k, 1]) / FIELD_CELL
            y = start_y + (s * points[k, 0] + c * points[k, 1]) / FIELD_CELL
            mark_seen(seen, start_x / SEEN_CELLS, start_y / SEEN_CELLS, x / SEEN_CELLS, y / SEEN_CELLS)
    return count, len(points)


@inlined
def _find_kinds(field, waiting, scan, start_x, start_y, c, s, points, kinds):  # type: ignore[no-untyped-def]
    """Store the kinds (p,) of the points (p, 6) of a scan, see `free_space`, before any of them enters the field.

    The scan has the number `scan`, and was taken at (start_x, start_y), in cells, at a heading with the cosine `c` and
    the sine `s`.
    """
    for k in range(len(points)):
        x = start_x + (c * points[k, 0] - s * points[k, 1]) / FIELD_CELL
        y = start_y + (s * points[k, 0] + c * points[k, 1]) / FIELD_CELL
        kinds[k] = IN_UNSEEN_SPACE
        if not _surroundings_are_inside(x, y, field[3]):
            kinds[k] = OUTSIDE
        elif nearest_distance(field, ALL_POINTS, x, y) < NEW_SURFACE:
            kinds[k] = KNOWN
        elif is_surrounded(field[3], x, y):
            seen_before, at_rest = add_sighting(waiting, scan, x, y)
            kinds[k] = KNOWN if at_rest else APPEARED if seen_before else NEW


@inlined
def _surroundings_are_inside(x, y, seen):  # type: ignore[no-untyped-def]
    """Return True if all cells that a point at (x, y), in cells, changes are in the field."""
    cells, row, column = SEEN_CELLS * len(seen), math.floor(x), math.floor(y)
    return SPAN <= row < cells - SPAN and SPAN <= column < cells - SPAN


@inlined
def belongs_to(grid, normal_x, normal_y):  # type: ignore[no-untyped-def]
    """Return True if a point with a normal, zero if unknown, belongs to a grid."""
    along = normal_x if grid % 2 == 0 else normal_y
    unknown = normal_x == 0.0 and normal_y == 0.0
    return grid == ALL_POINTS or unknown or (along if grid < 2 else -along) > MIN_FACING


@inlined
def _is_known(tile_of, tiles, grid, x, y):  # type: ignore[no-untyped-def]
    """Return True if there is a point at (x, y), in cells, already."""
    row, column = math.floor(x), math.floor(y)
    dx, dy = metres(offset_at(tile_of, tiles, grid, row, column))
    dx, dy = dx + FIELD_CELL * (x - row - 0.5), dy + FIELD_CELL * (y - column - 0.5)
    return dx * dx + dy * dy < SAME_POINT * SAME_POINT


@inlined
def facing_grid(normal_x, normal_y):  # type: ignore[no-untyped-def]
    """Return the number of the grid for a surface with a normal, that of all points if the normal is zero."""
    if normal_x == 0.0 and normal_y == 0.0:
        return ALL_POINTS
    if abs(normal_x) >= abs(normal_y):
        return 0 if normal_x > 0.0 else 2
    return 1 if normal_y > 0.0 else 3


@inlined
def nearest_distance(field, grid, x, y):  # type: ignore[no-untyped-def]
    """Return the distance (metres) from the cell of (x, y) to the nearest point of a grid; at most MAX_DISTANCE.

    field  see `DistanceField.arrays`
    grid   number of the direction that surfaces face, or ALL_POINTS
    x, y   in cells, from the corner of the field
    """
    _, tile_of, tiles, seen = field
    row, column, cells = math.floor(x), math.floor(y), SEEN_CELLS * len(seen)
    if row < 0 or column < 0 or row >= cells or column >= cells:
        return MAX_DISTANCE
    dx, dy = metres(offset_at(tile_of, tiles, grid, row, column))
    return min(MAX_DISTANCE, math.sqrt(dx * dx + dy * dy))

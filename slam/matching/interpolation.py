"""Normal equations of a scan's points in the distance field, by interpolation between its cells.

The work is done in blocks of points. Steps without branches are loops of their own: many points are computed at once
there.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled, inlined
from drivers.small_matrices import without_negative_part

from .distance_field import facing_grid
from .free_space import SEEN_CELLS, is_seen
from .offset_tiles import FIELD_CELL, NO_OFFSET, metres, offset_at
from .scan_points import WEIGHT

# Points of a block. Origin: measured, 32 and 128 take as long or longer.
BLOCK = 64


@compiled
def memory_for(count):  # type: ignore[no-untyped-def]
    """Return memory to interpolate up to `count` points at once: rows, vectors, and what a block needs."""
    return np.empty(count, np.int64), np.empty((count, 2)), np.zeros((5, BLOCK)), np.zeros((4, BLOCK), np.int32)


@inlined
def add_points(pose, points, field, sigma, information, gradient, memory):  # type: ignore[no-untyped-def]
    """Set the normal equations of points (p, 6) with normals, in the base's frame, with the base at `pose`.

    Each point measures the offset from the nearest point of the field along its normal, or along both axes if it has
    none. The offset is zero with standard deviation `sigma` (metres) and a Cauchy kernel of the same scale. Points in
    unseen cells are left out: what is seen for the first time, such as the continuation of a wall, is near known points
    without being at them. Information (3, 3) and gradient (3,) refer to the base's axes. For `memory` see `memory_for`.
    Returns the number of points that are not left out.
    """
    rows, vectors, _, _ = memory
    found = _interpolate(pose, points, field, memory)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for m in range(found):
        point, dx, dy = points[rows[m]], vectors[m, 0], vectors[m, 1]
        normal_x, normal_y = c * point[2] - s * point[3], s * point[2] + c * point[3]
        weight = point[WEIGHT] / (sigma * sigma + dx * dx + dy * dy)
        if normal_x != 0.0 or normal_y != 0.0:
            sums = _add_row(sums, point, normal_x, normal_y, c, s, weight, normal_x * dx + normal_y * dy)
        else:
            sums = _add_row(sums, point, 1.0, 0.0, c, s, weight, dx)
            sums = _add_row(sums, point, 0.0, 1.0, c, s, weight, dy)
    gradient[0], gradient[1], gradient[2] = sums[:3]
    _set_symmetric(information, sums)
    return found


@compiled
def unbiased_information(pose, points, found, sigma, information, memory):  # type: ignore[no-untyped-def]
    """Return the `information` (3, 3) of points without their excess (see `surface_points`).

    The other arguments are those of `add_points` before, and `found` is what it returned. The excess is a mean, so that
    the difference may be negative in directions of which the points show nothing: there, zero is returned.
    """
    rows, vectors, _, _ = memory
    c, s = math.cos(pose[2]), math.sin(pose[2])
    sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for m in range(found):
        point, dx, dy = points[rows[m]], vectors[m, 0], vectors[m, 1]
        if point[4] == 0.0:
            continue
        normal_x, normal_y = c * point[2] - s * point[3], s * point[2] + c * point[3]
        weight = point[WEIGHT] * point[4] / (sigma * sigma + dx * dx + dy * dy)
        if normal_x != 0.0 or normal_y != 0.0:
            sums = _add_row(sums, point, -normal_y, normal_x, c, s, weight, 0.0)
        else:
            sums = _add_row(sums, point, 1.0, 0.0, c, s, weight, 0.0)
            sums = _add_row(sums, point, 0.0, 1.0, c, s, weight, 0.0)
    excess = np.empty((3, 3))
    _set_symmetric(excess, sums)
    return without_negative_part(information - excess)


@inlined
def _set_symmetric(matrix, sums):  # type: ignore[no-untyped-def]
    """Set a matrix (3, 3) to the sums of equations, the results of `_add_row`."""
    matrix[0, 0], matrix[1, 1], matrix[2, 2] = sums[3:6]
    matrix[0, 1], matrix[0, 2], matrix[1, 2] = sums[6:]
    matrix[1, 0], matrix[2, 0], matrix[2, 1] = sums[6:]


@inlined
def _add_row(sums, point, x, y, c, s, weight, residual):  # type: ignore[no-untyped-def]
    """Add one equation to the sums: the point is `residual` metres off along the unit vector (x, y) of the map."""
    forward, left = c * x + s * y, -s * x + c * y
    turn = point[0] * left - point[1] * forward
    return (
        sums[0] + weight * residual * forward,
        sums[1] + weight * residual * left,
        sums[2] + weight * residual * turn,
        sums[3] + weight * forward * forward,
        sums[4] + weight * left * left,
        sums[5] + weight * turn * turn,
        sums[6] + weight * forward * left,
        sums[7] + weight * forward * turn,
        sums[8] + weight * left * turn,
    )


@compiled
def interpolate(pose, points, field):  # type: ignore[no-untyped-def]
    """Return the rows (m,) of points (p, 6) near a surface, and the vectors (m, 2) from there in the map, metres.

    The points are in the base's frame, with the base at `pose`. Near is a point in a seen cell in which a point of the
    field is the nearest one that faces the same way. The vector is interpolated between those from the points that are
    nearest to the four cells around, so that it is linear near a surface. Those from another surface, on the other
    side, are left out.
    """
    memory = memory_for(len(points))
    found = _interpolate(pose, points, field, memory)
    return memory[0][:found], memory[1][:found]


@inlined
def _interpolate(pose, points, field, memory):  # type: ignore[no-untyped-def]
    """Set the first rows and vectors of `memory`, and return how many there are; see `interpolate`."""
    rows, vectors, placed, offsets = memory
    c, s, found = math.cos(pose[2]), math.sin(pose[2]), 0
    for start in range(0, len(points), BLOCK):
        count, begin = min(BLOCK, len(points) - start), found
        _place(placed, points, start, count, pose[0], pose[1], c, s, field[0][0], field[0][1])
        count = _look_up(rows[begin:], offsets, placed, points, start, count, c, s, field)
        _add_cells(placed, offsets)
        for m in range(count):
            total = placed[4, m]
            if total > 0.0:
                rows[found] = rows[begin + m]
                vectors[found, 0], vectors[found, 1] = placed[2, m] / total, placed[3, m] / total
                found += 1
    return found


@inlined
def _place(placed, points, start, count, pose_x, pose_y, c, s, origin_x, origin_y):  # type: ignore[no-untyped-def]
    """Set the rows 0 and 1 of `placed` (5, BLOCK): x and y of points in the field, in cells."""
    for m in range(count):
        x, y = points[start + m, 0], points[start + m, 1]
        placed[0, m], placed[1, m] = pose_x + (c * x - s * y) - origin_x, pose_y + (s * x + c * y) - origin_y
    for m in range(BLOCK):
        placed[0, m], placed[1, m] = placed[0, m] / FIELD_CELL, placed[1, m] / FIELD_CELL


@inlined
def _look_up(rows, offsets, placed, points, start, count, c, s, field):  # type: ignore[no-untyped-def]
    """Keep the points of a block that are in seen cells; return their number.

    Sets their `rows` (BLOCK,), and the `offsets` (4, BLOCK) of the four cells around each.
    """
    _, tile_of, tiles, seen = field
    last, kept = SEEN_CELLS * len(seen) - 1, 0
    for m in range(count):
        x, y, k = placed[0, m], placed[1, m], start + m
        i, j = math.floor(x - 0.5), math.floor(y - 0.5)
        if not is_seen(seen, x, y) or i < 0 or j < 0 or i >= last or j >= last:
            continue
        grid = facing_grid(c * points[k, 2] - s * points[k, 3], s * points[k, 2] + c * points[k, 3])
        rows[kept], placed[0, kept], placed[1, kept] = k, x, y
        offsets[0, kept] = offset_at(tile_of, tiles, grid, i, j)
        offsets[1, kept] = offset_at(tile_of, tiles, grid, i, j + 1)
        offsets[2, kept] = offset_at(tile_of, tiles, grid, i + 1, j)
        offsets[3, kept] = offset_at(tile_of, tiles, grid, i + 1, j + 1)
        kept += 1
    return kept


@inlined
def _add_cells(placed, offsets):  # type: ignore[no-untyped-def]
    """Set the rows 2 to 4 of `placed`: sums over the four cells of weighted vectors (metres), and of the weights.

    The sum of the weights is zero if no point is near the cell in which a point is. All of a block is computed, also
    what is beyond the points that were kept: the number is known when this is compiled.
    """
    for m in range(BLOCK):
        x, y = placed[0, m], placed[1, m]
        row, column = np.floor(x - 0.5), np.floor(y - 0.5)
        top, left, bottom, right = x - row - 0.5, y - column - 0.5, x - (row + 1.0) - 0.5, y - (column + 1.0) - 0.5
        in_bottom, in_right = np.floor(x) > row, np.floor(y) > column
        in_top_row = offsets[1, m] if in_right else offsets[0, m]
        in_bottom_row = offsets[3, m] if in_right else offsets[2, m]
        own = in_bottom_row if in_bottom else in_top_row
        near_x, near_y = metres(own)
        near_x += FIELD_CELL * (bottom if in_bottom else top)
        near_y += FIELD_CELL * (right if in_right else left)
        sums = (0.0, 0.0, 0.0)
        sums = _add_cell(sums, offsets[0, m], top, left, near_x, near_y)
        sums = _add_cell(sums, offsets[1, m], top, right, near_x, near_y)
        sums = _add_cell(sums, offsets[2, m], bottom, left, near_x, near_y)
        sums = _add_cell(sums, offsets[3, m], bottom, right, near_x, near_y)
        placed[2, m], placed[3, m], placed[4, m] = sums[0], sums[1], 0.0 if own == NO_OFFSET else sums[2]


@inlined
def _add_cell(sums, offset, x, y, near_x, near_y):  # type: ignore[no-untyped-def]
    """Add the vector of a cell, from whose centre the point is at (x, y) in cells, unless it is from the other side."""
    dx, dy = metres(offset)
    dx, dy = dx + FIELD_CELL * x, dy + FIELD_CELL * y
    other_side = (dx * near_x + dy * near_y < 0.0) & (dx * dx + dy * dy > FIELD_CELL * FIELD_CELL)
    weight = (1.0 - abs(x)) * (1.0 - abs(y))
    weight = 0.0 if (offset == NO_OFFSET) | other_side else weight
    return sums[0] + weight * dx, sums[1] + weight * dy, sums[2] + weight

"""Rays that are cast between the segments of a plan, with an index of the segments by square cells.

Each cell lists the segments that may pass through it. A ray visits the cells along its way and ends at the first
segment that it meets, so its cost does not depend on the size of the plan.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers

# Metres, least side of a cell. Origin: numerical, some segments are in each cell of a furnished floor.
MIN_CELL = 1.0
# Cells of an index. Origin: numerical, 16 MB.
MAX_CELLS = 4_000_000
# Share of a cell: a cell also lists segments that are so near to it, and a ray goes on so far after a hit.
# Origin: numerical, far above rounding.
MARGIN = 1e-6


@immutable
class SegmentIndex:
    """Segments (n, 2, 2) by square cells.

    origin  (2,) lower corner of the first cell, metres
    cell    side, metres
    starts  (columns, rows + 1) first place in `rows` of each cell, and of the one above the last of the column
    rows    segments of each cell, ascending
    """

    segments: Floats
    origin: Floats
    cell: float
    starts: Integers
    rows: Integers

    @classmethod
    def of(cls, segments: Floats) -> SegmentIndex:
        """Return the index of at least one segment."""
        low, high = segments.min(axis=(0, 1)), segments.max(axis=(0, 1))
        cell = max(MIN_CELL, math.sqrt(float((high - low + MIN_CELL).prod()) / MAX_CELLS))
        columns, rows = (np.floor((high - low) / cell).astype(np.int64) + 1).tolist()
        counts = np.zeros((columns, rows), dtype=np.int64)
        _list_cells(segments, low, cell, counts, counts, np.zeros(0, dtype=np.int64), False)
        ends = np.cumsum(counts.ravel()).reshape(columns, rows)
        starts = np.column_stack([np.concatenate([[0], ends[:-1, -1]]), ends])
        listed = np.zeros(int(ends[-1, -1]), dtype=np.int64)
        _list_cells(segments, low, cell, starts[:, :-1].copy(), counts, listed, True)
        return cls(segments, low, cell, starts, listed)


@immutable
class Hits:
    """What rays from k places meet.

    distance  (k, r) metres; infinite for a ray that meets nothing
    row       (k, r) segment; -1 for a ray that meets nothing
    visible   (k,) rays that meet a segment from a side that can be seen; if they are too few, not all rays were cast
    """

    distance: Floats
    row: Integers
    visible: Integers


def cast_rays(
    index: SegmentIndex,
    one_sided: NDArray[np.bool_],
    thickness: float,
    places: Floats,
    directions: Floats,
    reach: float,
    least: int,
) -> Hits:
    """Cast rays from places (k, 2) in some directions (r, 2) and return the nearest segment of each.

    one_sided  (n,) true for a segment that can be seen from the left of the way from its first to its second point only
    thickness  metres by which such a segment counts as farther away, across, if it is met from its right
    reach      metres that a ray reaches
    least      visible rays that a place requires; once these cannot be reached any more, its other rays are not cast

    A ray p + t r meets the segment a + u (b - a) where t = (a - p) x (b - a) / r x (b - a) and
    u = (a - p) x r / r x (b - a), if t > 0 and 0 <= u <= 1. Of two segments at the same distance the first one counts.
    """
    shape = len(places), len(directions)
    distance, row = np.full(shape, np.inf), np.full(shape, -1)
    visible = np.zeros(len(places), dtype=np.int64)
    arrays = index.segments, index.origin, index.cell, index.starts, index.rows, one_sided, thickness
    _cast(arrays, np.ascontiguousarray(places), directions, reach, least, distance, row, visible)
    return Hits(distance, row, visible)


def mark_near(segments: Floats, origin: Floats, spacing: float, shape: tuple[int, int], limit: float) -> np.ndarray:
    """Return (columns, rows) true for the places of a square grid that are nearer than `limit` to a segment.

    origin   (2,) first place, metres
    spacing  of the places, metres
    """
    marks = np.zeros(shape, dtype=np.bool_)
    _mark_near(segments, origin, spacing, limit, marks)
    return marks


def pieces_near_line(pieces: Floats, left: NDArray[np.bool_], start: Floats, across: Floats, limit: float) -> Integers:
    """Return the rows of the pieces (n, 2, 2) that are `left` (n,) and start near a line.

    start   (2,) point on the line
    across  (2,) unit vector perpendicular to it
    limit   metres from the line
    """
    rows = np.empty(len(pieces), dtype=np.int64)
    return rows[: _find_near_line(pieces, left, start, across, limit, rows)]


def tour(places: Floats) -> Integers:
    """Return an order (k,) of places (k, 2) in which each place is followed by the nearest one not visited yet."""
    order = np.zeros(len(places), dtype=np.int64)
    _tour(places, np.ones(len(places), dtype=np.bool_), order)
    return order


@compiled
def _span_within(segment, low, high):  # type: ignore[no-untyped-def]
    """Return the least and the largest y of the part of a segment with x between `low` and `high`, if there is any."""
    x0, y0, x1, y1 = segment[0, 0], segment[0, 1], segment[1, 0], segment[1, 1]
    if x0 == x1:
        return min(y0, y1), max(y0, y1)
    slope = (y1 - y0) / (x1 - x0)
    begin = y0 + slope * (min(max(low, min(x0, x1)), max(x0, x1)) - x0)
    end = y0 + slope * (min(max(high, min(x0, x1)), max(x0, x1)) - x0)
    return min(begin, end), max(begin, end)


@compiled
def _clipped(value, count):  # type: ignore[no-untyped-def]
    """Return the number of the cell at a coordinate in cells, of those that there are."""
    return min(max(math.floor(value), 0), count - 1)


@compiled
def _list_cells(segments, origin, cell, places, counts, listed, fill):  # type: ignore[no-untyped-def]
    """Count the segments of each cell, or list them, each at the next one of `places`, which is advanced."""
    columns, rows = counts.shape
    for k in range(len(segments)):
        segment = segments[k]
        first = _clipped((min(segment[0, 0], segment[1, 0]) - origin[0]) / cell - MARGIN, columns)
        last = _clipped((max(segment[0, 0], segment[1, 0]) - origin[0]) / cell + MARGIN, columns)
        for i in range(first, last + 1):
            left = origin[0] + (i - MARGIN) * cell
            low, high = _span_within(segment, left, left + (1.0 + 2.0 * MARGIN) * cell)
            bottom = _clipped((low - origin[1]) / cell - MARGIN, rows)
            top = _clipped((high - origin[1]) / cell + MARGIN, rows)
            for j in range(bottom, top + 1):
                if fill:
                    listed[places[i, j]] = k
                places[i, j] += 1


@compiled
def _mark_near(segments, origin, spacing, limit, marks):  # type: ignore[no-untyped-def]
    """Mark places; see `mark_near`."""
    columns, rows = marks.shape
    for k in range(len(segments)):
        segment = segments[k]
        dx, dy = segment[1, 0] - segment[0, 0], segment[1, 1] - segment[0, 1]
        squared = max(dx * dx + dy * dy, 1e-12)
        first = math.ceil((min(segment[0, 0], segment[1, 0]) - limit - origin[0]) / spacing)
        last = math.floor((max(segment[0, 0], segment[1, 0]) + limit - origin[0]) / spacing)
        for i in range(max(first, 0), min(last, columns - 1) + 1):
            x = origin[0] + i * spacing
            low, high = _span_within(segment, x - limit, x + limit)
            bottom = math.ceil((low - limit - origin[1]) / spacing)
            top = math.floor((high + limit - origin[1]) / spacing)
            for j in range(max(bottom, 0), min(top, rows - 1) + 1):
                px, py = x - segment[0, 0], origin[1] + j * spacing - segment[0, 1]
                share = min(max((px * dx + py * dy) / squared, 0.0), 1.0)
                if math.hypot(share * dx - px, share * dy - py) < limit:
                    marks[i, j] = True


@compiled
def _nearest_on_ray(arrays, px, py, rx, ry, reach):  # type: ignore[no-untyped-def]
    """Return the distance of the nearest segment on a ray and its row, and true if the ray meets a visible side."""
    segments, origin, cell, starts, rows, one_sided, thickness = arrays
    columns, count = starts.shape[0], starts.shape[1] - 1
    x, y = (px - origin[0]) / cell, (py - origin[1]) / cell
    i, j = math.floor(x), math.floor(y)
    step_i, step_j = (1 if rx > 0.0 else -1), (1 if ry > 0.0 else -1)
    to_i = ((i + (1 if rx > 0.0 else 0)) - x) * cell / rx if rx != 0.0 else np.inf
    to_j = ((j + (1 if ry > 0.0 else 0)) - y) * cell / ry if ry != 0.0 else np.inf
    entered, best, distance, row, seen = 0.0, np.inf, np.inf, -1, False
    while entered < reach and entered - MARGIN * cell <= best:
        if 0 <= i < columns and 0 <= j < count:
            for at in range(starts[i, j], starts[i, j + 1]):
                k = rows[at]
                sx, sy = segments[k, 0, 0] - px, segments[k, 0, 1] - py
                dx, dy = segments[k, 1, 0] - segments[k, 0, 0], segments[k, 1, 1] - segments[k, 0, 1]
                across = rx * dy - ry * dx
                if across == 0.0:  # parallel, or a point
                    continue
                t = (sx * dy - sy * dx) / across
                u = (sx * ry - sy * rx) / across
                if not (t > 0.0 and t < reach and u >= 0.0 and u <= 1.0):
                    continue
                on_left = sx * dy - sy * dx > 0.0
                away = one_sided[k] and not on_left
                key = t + thickness * math.hypot(dx, dy) / abs(across) if away else t
                if key < best or (key == best and k < row):
                    best, distance, row, seen = key, t, k, not away
        if to_i < to_j:
            entered, i, to_i = to_i, i + step_i, to_i + cell / abs(rx)
        else:
            entered, j, to_j = to_j, j + step_j, to_j + cell / abs(ry)
    return distance, row, seen


@compiled
def _cast(arrays, places, directions, reach, least, distance, row, visible):  # type: ignore[no-untyped-def]
    """Cast the rays of all places; see `cast_rays`."""
    rays = len(directions)
    for place in range(len(places)):
        for ray in range(rays):
            if visible[place] + rays - ray < least:
                break
            found, k, seen = _nearest_on_ray(
                arrays, places[place, 0], places[place, 1], directions[ray, 0], directions[ray, 1], reach
            )
            distance[place, ray], row[place, ray] = found, k
            visible[place] += seen


@compiled
def _tour(places, left, order):  # type: ignore[no-untyped-def]
    """Find the order of the places; see `tour`."""
    if len(places):
        left[0] = False
    for k in range(1, len(places)):
        nearest, least = -1, np.inf
        for other in range(len(places)):
            if not left[other]:
                continue
            dx, dy = places[other, 0] - places[order[k - 1], 0], places[other, 1] - places[order[k - 1], 1]
            if dx * dx + dy * dy < least:
                nearest, least = other, dx * dx + dy * dy
        order[k], left[nearest] = nearest, False


@compiled
def _find_near_line(pieces, left, start, across, limit, rows):  # type: ignore[no-untyped-def]
    """Write the rows of pieces that start near a line, and return their number; see `pieces_near_line`."""
    count = 0
    for k in range(len(pieces)):
        dx, dy = pieces[k, 0, 0] - start[0], pieces[k, 0, 1] - start[1]
        if left[k] and abs(dx * across[0] + dy * across[1]) <= limit:
            rows[count] = k
            count += 1
    return count

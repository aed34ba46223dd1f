"""Search for a submap on a grid of poses of a map, by its points.

Pairs of walls that cross determine a pose, but where a submap shows the walls of a corridor and things that are no
walls, no pair tells how far along the corridor it is. So its points are compared with the map at each place that was
seen, with the headings at which its walls are parallel to walls of the map.
"""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.angles import wrap_angle
from ..geometry.segments import Floats
from ..geometry.significance import MOST
from ..loop_closure.submap_search import lowest_around
from ..matching.distance_field import facing_grid
from ..matching.free_space import SEEN_CELL, SEEN_CELLS
from ..matching.offset_tiles import FIELD_CELL
from ..matching.point_costs import UNSEEN, cost_at
from ..matching.point_matcher import MAX_SEARCH_POINTS
from ..matching.scan_points import subsample
from .map_descriptor import MapDescriptor
from .scanned_map import DriveSubmap, ScannedMap
from .wall_pairs import HEADING_CELLS


def search_grid(submap: DriveSubmap, known: ScannedMap, most: int) -> Floats:
    """Return poses (k, 3) of a submap in a map at which its points fit better than around, at most `most`.

    The best are first. A pose at which the points would fit less than a place that was not seen is left out.
    """
    headings = parallel_headings(submap.scan.descriptor, known.index.descriptor)
    points = np.ascontiguousarray(subsample(submap.points.points, MAX_SEARCH_POINTS))
    if not len(headings) or not len(points):
        return np.zeros((0, 3))
    found = [np.zeros((0, 4))]  # costs and poses
    for heading in headings.tolist():  # one after the other, as large maps have millions of cells
        costs = _grid_costs(known.field.arrays, points, heading)
        low = np.argwhere((costs == lowest_around(costs)) & np.isfinite(costs))
        positions = known.field.origin + SEEN_CELL * (low + 0.5)
        found.append(np.column_stack([costs[low[:, 0], low[:, 1]], positions, np.full(len(low), heading)]))
    poses = np.concatenate(found)
    return np.asarray(poses[np.argsort(poses[:, 0], kind="stable")[:most], 1:])


def parallel_headings(submap: MapDescriptor, known: MapDescriptor) -> Floats:
    """Return the headings (k,) of a submap in a map at which its walls are parallel to most metres of the map's walls.

    Both must be seen from the same side. Headings with less than half of the metres of the best one are left out.
    """
    turns = (known.frame[:, None, 2] - submap.frame[:, 2]).ravel() % (2.0 * math.pi)
    lengths = np.minimum(known.half_length[:, None], submap.half_length).ravel()
    if not len(turns):
        return turns
    cells = np.floor(turns * HEADING_CELLS / (2.0 * math.pi)).astype(np.int64) % HEADING_CELLS
    total = np.bincount(cells, lengths, HEADING_CELLS)
    around = total + np.roll(total, 1) + np.roll(total, -1)
    strongest = np.flatnonzero(
        (around > np.roll(around, 1)) & (around >= np.roll(around, -1)) & (around >= MOST * around.max())
    )
    found = []
    for cell in strongest.tolist():
        middle = (cell + 0.5) * 2.0 * math.pi / HEADING_CELLS
        offsets = se2.wrap(turns - middle)
        near = np.abs(offsets) < 3.0 * math.pi / HEADING_CELLS
        found.append(wrap_angle(middle + float(np.average(offsets[near], weights=lengths[near]))))
    return np.array(found)


@compiled
def _grid_costs(field, points, heading):  # type: ignore[no-untyped-def]
    """Return the costs (s, s) of points (p, 6) with normals if their frame is in the middle of each cell that was seen.

    The cost is infinite if the cell was not seen, and if the points cost as much as where nothing was seen.
    """
    seen, limit = field[3], UNSEEN * len(points)
    turned = np.empty((len(points), 2))
    grids = np.empty(len(points), np.int64)
    c, s = math.cos(heading), math.sin(heading)
    for k in range(len(points)):
        turned[k, 0] = (c * points[k, 0] - s * points[k, 1]) / FIELD_CELL
        turned[k, 1] = (s * points[k, 0] + c * points[k, 1]) / FIELD_CELL
        grids[k] = facing_grid(c * points[k, 2] - s * points[k, 3], s * points[k, 2] + c * points[k, 3])
    costs = np.full(seen.shape, np.inf)
    for row in range(seen.shape[0]):
        for column in range(seen.shape[1]):
            if not seen[row, column]:
                continue
            x, y = (row + 0.5) * SEEN_CELLS, (column + 0.5) * SEEN_CELLS
            total = 0.0
            for k in range(len(points)):
                total += cost_at(field, grids[k], x + turned[k, 0], y + turned[k, 1])[0]
                if total >= limit:
                    break
            if total < limit:
                costs[row, column] = total
    return costs

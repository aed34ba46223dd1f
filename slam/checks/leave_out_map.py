"""Occupancy map of a finished drive from which scans can be left out, and how well the points of a scan fit it.

Each cell counts the beams that ended in it and those that passed through. Where at least as many beams ended as passed,
something is at rest: people who walked by are not in the map. A wall has two faces, some decimetres apart, so the beams
that ended are also counted by the direction that the surface faces. A point that lies where nothing was seen says
nothing, unless its beam passed through something at rest.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled, inlined

from ..geometry.segments import Floats, Integers
from ..mapping.sight_lines import MIN_DEPTH
from ..matching.distance_field import ALL_POINTS, belongs_to, facing_grid
from .distance_rings import CELL, RING_LIKELIHOODS, RINGS
from .passes import MAX_RANGE

# Cells of the map at most: larger areas have cells larger than CELL. Origin: numerical, 24 MB in six grids.
MAX_CELLS = 1_000_000
# Classes of cells beside the rings around what is at rest, and of those whose class is not known yet.
# Origin: definition.
FREE, UNSEEN, NOT_YET = RINGS, RINGS + 1, 255
# Likelihood of a point in each class of cells. Origin: definition.
LIKELIHOODS = np.append(RING_LIKELIHOODS, [0.0, np.nan])


class LeaveOutMap:
    """Counters of the beams that ended in each cell of an area (`hits`), and of those that passed (`passed`)."""

    def __init__(self, positions: Floats) -> None:
        """Begin an empty map of what can be seen from `positions` (n, 2), metres."""
        low = positions.min(axis=0) - MAX_RANGE
        size = positions.max(axis=0) + MAX_RANGE - low
        self.cell = max(CELL, math.sqrt(float(size.prod()) / MAX_CELLS))
        rows, columns = (math.floor(extent / self.cell) + 1 for extent in size)
        self._origin = np.array([*low, 0.0])
        self._hits = np.zeros((ALL_POINTS + 1, rows, columns), dtype=np.int32)
        self._passed = np.zeros((rows, columns), dtype=np.int32)
        self._classes: NDArray[np.uint8] = np.zeros((0, 0, 0), dtype=np.uint8)  # memory that is used again

    def add(self, points: Floats, pose: se2.Pose) -> None:
        """Add a scan of `points` (p, 6) with normals, in the frame of the base at `pose`, metres."""
        self._count(points, pose, 1)

    def leave_out(self, points: Floats, pose: se2.Pose) -> None:
        """Take a scan off that was added with the same points and pose."""
        self._count(points, pose, -1)

    def _count(self, points: Floats, pose: se2.Pose, step: int) -> None:
        reach, margin = MAX_RANGE / self.cell, MIN_DEPTH / self.cell
        _count(self._hits, self._passed, points, self.moved(pose), self.cell, reach, margin, step)

    def around(self, position: Floats, half_width: float) -> Surroundings:
        """Return the cells up to `half_width` metres from a `position` (2,) along each axis.

        Valid until the next change or call.
        """
        half = math.ceil(half_width / self.cell)
        first = np.floor((position - self._origin[:2]) / self.cell).astype(np.int64) - half
        shape = ALL_POINTS + 1, 2 * half + 1, 2 * half + 1
        if self._classes.shape != shape:
            self._classes = np.empty(shape, dtype=np.uint8)
        self._classes.fill(NOT_YET)
        return Surroundings(self, (self._hits, self._passed, self._classes, first))

    def moved(self, poses: Floats) -> Floats:
        """Return poses (3,) or (m, 3) with the position in cells of the map."""
        return np.asarray((poses - self._origin) * np.array([1.0 / self.cell, 1.0 / self.cell, 1.0]))


class Surroundings:
    """Part of a map in which a scan is compared.

    The class of a cell, an index of LIKELIHOODS, is found when it is needed first: most cells are never asked for.
    """

    def __init__(self, others: LeaveOutMap, arrays: tuple[Integers, Integers, NDArray[np.uint8], Integers]) -> None:
        """Take the counters of a map, the classes (5, n, n), and the row and the column at which these begin."""
        self._others, self._arrays = others, arrays

    def likelihoods(self, points: Floats, pose: se2.Pose) -> Floats:
        """Return the likelihood (p,) of each point of a scan at `pose`, NaN where the map says nothing.

        It is zero for a point in free space, or behind something at rest.
        """
        return np.asarray(_likelihoods(self._arrays, points, self._others.moved(pose), self._others.cell))

    def gains(self, points: Floats, before: Floats, poses: Floats) -> Floats:
        """Return (m,) how much better the points fit at each of `poses` (m, 3) than with the likelihoods `before` (p,).

        Points count that the map can judge both there and before; the sum is relative to the number of all points.
        """
        return np.asarray(_gains(self._arrays, points, before, self._others.moved(poses), self._others.cell))


@compiled
def _count(hits, passed, points, pose, cell, reach, margin, step):  # type: ignore[no-untyped-def]
    """Add `step` to the cells in which the beams of a scan end, and to those that they pass.

    Lengths are in cells, except for those of the points and of a `cell`, which are in metres.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for p in range(len(points)):
        length = math.hypot(points[p, 0] / cell, points[p, 1] / cell)
        dx, dy = _turned(points, p, cell, c, s)
        if length <= reach:
            row, column = math.floor(pose[0] + dx), math.floor(pose[1] + dy)
            if 0 <= row < hits.shape[1] and 0 <= column < hits.shape[2]:
                nx, ny = c * points[p, 2] - s * points[p, 3], s * points[p, 2] + c * points[p, 3]
                for facing in range(ALL_POINTS + 1):
                    if belongs_to(facing, nx, ny):
                        hits[facing, row, column] += step
        followed = min(length - margin, reach)
        count = max(abs(dx), abs(dy))  # one cell after the other along the longer axis
        for k in range(int(count * followed / max(length, 1e-9))):
            row, column = math.floor(pose[0] + k * dx / count), math.floor(pose[1] + k * dy / count)
            if 0 <= row < hits.shape[1] and 0 <= column < hits.shape[2]:
                passed[row, column] += step


@inlined
def _class_at(arrays, facing, x, y):  # type: ignore[no-untyped-def]
    """Return the class of the cell of (x, y) for surfaces that face in a direction, or for points without a normal."""
    hits, passed, classes, first = arrays
    row, column = math.floor(x), math.floor(y)
    i, j = row - first[0], column - first[1]
    if not (0 <= i < classes.shape[1] and 0 <= j < classes.shape[2]):
        return UNSEEN
    if classes[facing, i, j] == NOT_YET:
        classes[facing, i, j] = _classify(hits, passed, facing, row, column)
    return classes[facing, i, j]


@compiled
def _classify(hits, passed, facing, row, column):  # type: ignore[no-untyped-def]
    """Return the class of a cell: the ring around the nearest cell at rest, else FREE or UNSEEN."""
    rows, columns = passed.shape
    found = UNSEEN
    if 0 <= row < rows and 0 <= column < columns and hits[ALL_POINTS, row, column] + passed[row, column] > 0:
        found = FREE
    for i in range(max(row - RINGS + 1, 0), min(row + RINGS, rows)):
        for j in range(max(column - RINGS + 1, 0), min(column + RINGS, columns)):
            if hits[facing, i, j] > 0 and hits[ALL_POINTS, i, j] >= passed[i, j]:  # at rest; true of few cells
                ring = int(math.hypot(i - row, j - column))
                found = ring if ring < min(found, RINGS) else found
    return found


@compiled
def _likelihoods(arrays, points, pose, cell):  # type: ignore[no-untyped-def]
    """Return the likelihood of each point at a pose; see `Surroundings.likelihoods`."""
    found = np.empty(len(points))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for p in range(len(points)):
        found[p] = _likelihood(arrays, points, p, pose, cell, c, s)
        if math.isnan(found[p]):
            dx, dy = _turned(points, p, cell, c, s)
            if _passes_through(arrays, pose, dx, dy):
                found[p] = 0.0
    return found


@inlined
def _turned(points, p, cell, c, s):  # type: ignore[no-untyped-def]
    """Return the position of point p in cells, turned by an angle with the cosine c and the sine s."""
    x, y = points[p, 0] / cell, points[p, 1] / cell
    return c * x - s * y, s * x + c * y


@inlined
def _likelihood(arrays, points, p, pose, cell, c, s):  # type: ignore[no-untyped-def]
    """Return the likelihood of point p at a pose with the cosine c and the sine s of its heading."""
    dx, dy = _turned(points, p, cell, c, s)
    x, y = pose[0] + dx, pose[1] + dy
    nx, ny = c * points[p, 2] - s * points[p, 3], s * points[p, 2] + c * points[p, 3]
    return LIKELIHOODS[_class_at(arrays, facing_grid(nx, ny), x, y)]


@inlined
def _passes_through(arrays, pose, dx, dy):  # type: ignore[no-untyped-def]
    """Return True if a beam passes a cell at rest and comes out of all rings around it."""
    count = max(abs(dx), abs(dy), 1.0)
    inside = False
    for k in range(int(count)):
        found = _class_at(arrays, ALL_POINTS, pose[0] + k * dx / count, pose[1] + k * dy / count)
        if found == 0:
            inside = True
        elif inside and found >= FREE:
            return True
    return False


@compiled
def _gains(arrays, points, before, poses, cell):  # type: ignore[no-untyped-def]
    """Return the gain at each pose; see `Surroundings.gains`."""
    gains = np.zeros(len(poses))
    for k in range(len(poses)):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for p in range(len(points)):
            if not math.isnan(before[p]):
                likelihood = _likelihood(arrays, points, p, poses[k], cell, c, s)
                if not math.isnan(likelihood):
                    gains[k] += likelihood - before[p]
        gains[k] /= len(points)
    return gains

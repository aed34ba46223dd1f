"""How well a scan fits the scans just before it, at any pose.

The field is a grid of counters that wraps around at its borders, so it follows the robot without being moved: a scan is
added with its distance rings, and taken off again when it leaves the window.
"""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import Floats
from ..geometry.surroundings import SURFACE_DEPTH
from ..localisation.view_change import MAX_COMPARED_POINTS

# Metres, side of a cell. Origin: definition; finer cells would only cost time.
CELL = SURFACE_DEPTH
# Cells along each side of the grid. Origin: geometry, two scans that both see MAX_RANGE do not overlap through the
# wrap as long as they are taken less than 26 m apart.
CELLS = 768
# Metres; points farther away are left out, as heading errors move them by more than a cell. Origin: chosen.
MAX_RANGE = 25.0
# Metres within which a point supports another one: wider than the blur of a good map, narrower than a doorway.
# Origin: chosen; not measured.
REACH = 0.3
# Rings of equal width up to REACH. Origin: geometry, each as wide as a cell.
RINGS = round(REACH / CELL)
# Metres, standard deviation of the distance between a point and the points of other scans of the same surface.
# Origin: chosen, a cell and the noise of lidars; not measured.
FIT_SIGMA = 0.13
# Metres, middle of each ring. Origin: geometry.
RING_DISTANCES = REACH * (np.arange(RINGS) + 0.5) / RINGS
# Relative to the innermost ring. Origin: definition, normal distribution.
RING_LIKELIHOODS = np.exp(-(RING_DISTANCES**2 - RING_DISTANCES[0] ** 2) / (2 * FIT_SIGMA**2))


class DistanceRings:
    """Grid of the distances to the points of some scans."""

    def __init__(self) -> None:
        self._counts = np.zeros((RINGS, CELLS, CELLS), dtype=np.int16)

    def add(self, points: Floats, pose: se2.Pose) -> None:
        """Add a scan of `points` (p, 2) in the base's frame, taken at `pose`."""
        _enter(self._counts, points, pose, 1)

    def remove(self, points: Floats, pose: se2.Pose) -> None:
        """Remove a scan that was added with the same points and pose."""
        _enter(self._counts, points, pose, -1)

    def fits(self, points: Floats, poses: Floats) -> Floats:
        """Return the fit (m,) of a scan's points at each of `poses` (m, 3), 0 to 1.

        The fit is the mean likelihood of the points within MAX_RANGE, by the ring in which each lies.
        """
        return np.asarray(_fits(self._counts, points, poses))


def compared_points(points: Floats) -> Floats:
    """Return (q, 2) at most MAX_COMPARED_POINTS of a scan's points (p, 2), evenly chosen."""
    return np.ascontiguousarray(points[:: max(1, -(-len(points) // MAX_COMPARED_POINTS))])


@compiled
def _enter(counts, points, pose, step):  # type: ignore[no-untyped-def]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for p in range(len(points)):
        if points[p, 0] ** 2 + points[p, 1] ** 2 > MAX_RANGE**2:
            continue
        x = (pose[0] + c * points[p, 0] - s * points[p, 1]) / CELL
        y = (pose[1] + s * points[p, 0] + c * points[p, 1]) / CELL
        row, column = math.floor(x), math.floor(y)
        first, last = (row - RINGS) % CELLS, (column - RINGS) % CELLS  # a ring is one cell wide
        for i in range(2 * RINGS + 1):
            dx = row - RINGS + i + 0.5 - x
            in_row = first + i if first + i < CELLS else first + i - CELLS
            for j in range(2 * RINGS + 1):
                dy = column - RINGS + j + 0.5 - y
                squared = dx * dx + dy * dy
                if squared < RINGS * RINGS:
                    in_column = last + j if last + j < CELLS else last + j - CELLS
                    counts[int(math.sqrt(squared)), in_row, in_column] += step


@compiled
def _fits(counts, points, poses):  # type: ignore[no-untyped-def]
    fits = np.zeros(len(poses))
    for k in range(len(poses)):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        total, number = 0.0, 0
        for p in range(len(points)):
            if points[p, 0] ** 2 + points[p, 1] ** 2 > MAX_RANGE**2:
                continue
            i = math.floor((poses[k, 0] + c * points[p, 0] - s * points[p, 1]) / CELL) % CELLS
            j = math.floor((poses[k, 1] + s * points[p, 0] + c * points[p, 1]) / CELL) % CELLS
            number += 1
            for ring in range(RINGS):
                if counts[ring, i, j] > 0:
                    total += RING_LIKELIHOODS[ring]
                    break
        fits[k] = total / max(1, number)
    return fits

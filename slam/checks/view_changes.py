"""Steps at which the view changes abruptly, although the path says that the robot hardly moved.

Each scan is compared with the scan before. In each direction, points nearer than the points of the scan before lie in
space that it saw through; points farther away lie behind what it saw.
"""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import Integers
from ..mapping.sight_lines import MIN_DEPTH
from .drive import Drive
from .passes import MAX_CONTRADICTION

# Directions in which the ranges of a scan are compared. Origin: chosen, the beams of a half-circle lidar; a sparser
# lidar leaves some empty, which are not compared.
DIRECTIONS = 180
# Points that contradict the scan before it, per point that agrees. Origin: tuned on fhw, where steps through a crowd
# reach 1.07 on right paths, and on a simulated robot that was carried into another room, with 3.
MIN_RATIO = 2.0


def view_changes(drive: Drive) -> tuple[Integers, Integers]:
    """Return the steps (m,) of a sampled drive at which the view changes abruptly, and counts (m, 3) of points.

    The three counts are of points in space that the scan before saw through, behind what it saw, and on what it saw.
    """
    steps = se2.between(drive.poses[:-1], drive.poses[1:])
    counts = np.zeros((len(steps), 3), dtype=np.int64)
    for k, step in enumerate(steps):
        if drive.segment[k] == drive.segment[k + 1]:
            _compare(drive.points[k], drive.points[k + 1], step, counts[k])
    both = np.minimum(counts[:, 0], counts[:, 1]) > MAX_CONTRADICTION * counts.sum(axis=1)
    found = np.flatnonzero(both & (counts[:, 0] + counts[:, 1] > MIN_RATIO * counts[:, 2]))
    return found, counts[found]


@compiled
def _compare(before, points, step, counts):  # type: ignore[no-untyped-def]
    """Count the points of a scan, taken after the motion `step`, by what the scan `before` saw in their directions."""
    nearest, farthest = np.full(DIRECTIONS, np.inf), np.zeros(DIRECTIONS)
    for p in range(len(before)):
        i = int((math.atan2(before[p, 1], before[p, 0]) / (2 * math.pi) + 0.5) * DIRECTIONS) % DIRECTIONS
        distance = math.hypot(before[p, 0], before[p, 1])
        nearest[i], farthest[i] = min(nearest[i], distance), max(farthest[i], distance)
    c, s = math.cos(step[2]), math.sin(step[2])
    for p in range(len(points)):
        x = step[0] + c * points[p, 0] - s * points[p, 1]
        y = step[1] + s * points[p, 0] + c * points[p, 1]
        middle = int((math.atan2(y, x) / (2 * math.pi) + 0.5) * DIRECTIONS)
        low, high = np.inf, 0.0
        for i in range(middle - 1, middle + 2):
            low, high = min(low, nearest[i % DIRECTIONS]), max(high, farthest[i % DIRECTIONS])
        if high > 0.0:
            distance = math.hypot(x, y)
            counts[0 if distance < low - MIN_DEPTH else 1 if distance > high + MIN_DEPTH else 2] += 1

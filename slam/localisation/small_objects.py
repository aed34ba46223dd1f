"""Small objects that may have moved, such as people, and how much they count in a match.

A person who walks beside the robot looks the same from scan to scan. Along a corridor nothing else determines the
position: the scan fits best at a pose where both stand still, although odometry has measured that the robot drives.

A small object moves as a whole. If none of its points fits, that is one event, whose cost is minus the logarithm of its
probability: the share of the small objects around the robot that have moved since they were mapped. This share is
learned while driving. Where nothing moves, most points of an object count; among many people, one or two of them do.

Equation: docs/mathematics.md#cost-of-a-pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined

from ..geometry.segments import Floats, Integers
from ..matching.distance_field import DistanceField
from ..matching.point_costs import MISFIT, UNSEEN, costs_of_points
from ..matching.point_matcher import POINTS_PER_OBJECT
from ..matching.scan_features import ScanFeatures
from ..matching.scan_points import LINE_DISTANCE, WEIGHT, lines_of
from ..odometry.velocity import STEADY_SECONDS
from .match_target import points_of

# Metres, largest size of an object that may move: the width of a person with a bag. Origin: chosen; with 1.2 m, a slip
# of the wheels in fr079 counted as furniture that had moved.
MAX_SIZE = 0.8
# Metres between the points of neighbouring beams of one object, and from it to what is beside it.
# Origin: chosen, the step of a walking person.
MAX_GAP = 0.3
# Objects that count before any driving, and those of them that have moved. Origin: chosen, between the shares measured
# in recordings: 0 to 4 % without people, 23 % in a museum. Few, as nothing is known of the place.
PRIOR_OBJECTS, PRIOR_MOVED = 5.0, 0.5
# Objects that are remembered: people come and go. Origin: chosen, some dozens of metres of driving in an office.
MAX_OBJECTS = 100.0
# Points of an object by which it is judged. Origin: chosen, a single one may be noise.
MIN_JUDGED_POINTS = 3


@dataclass(slots=True)
class SmallObjects:
    """Numbers of small objects near the robot, and of those that have moved since they were mapped.

    Scans in a row show the same objects. So those of a scan count by the time since the scan before, relative to
    STEADY_SECONDS.
    """

    seen: float = 0.0
    moved: float = 0.0

    @property
    def moved_cost(self) -> float:
        """Minus the logarithm of the probability that an object has moved: the mean of a posterior, with a prior."""
        return -math.log((PRIOR_MOVED + self.moved) / (PRIOR_OBJECTS + self.seen))

    def weighted_points(self, scan: ScanFeatures) -> Floats:
        """Return the points (p, 6) of a scan that are matched, with their weights, in the base's frame.

        An object none of whose points fits costs `moved_cost`, or less if it has few points: no weight is above 1.
        """
        return np.asarray(_weighted(points_of(scan), objects_of(scan), self.moved_cost))

    def add(self, scan: ScanFeatures, pose: se2.Pose, field: DistanceField, seconds: float) -> None:
        """Count the objects of a scan, `seconds` after the one before, with the base at `pose` in the field.

        An object has moved if its known points cost more than half of what points cost that fit nowhere.
        """
        judged, misfitting = _count(field.arrays, points_of(scan), objects_of(scan), pose)
        share = min(1.0, seconds / STEADY_SECONDS)
        seen, moved = share * judged, share * misfitting
        kept = min(1.0, MAX_OBJECTS / (self.seen + seen)) if seen else 1.0
        self.seen, self.moved = kept * (self.seen + seen), kept * (self.moved + moved)


def lasting_points(scan: ScanFeatures) -> Floats:
    """Return the points (p, 6) of a scan that are on no small object.

    An object that moves does so in scans in a row: their evidence about it does not add up.
    """
    return np.asarray(points_of(scan)[objects_of(scan) < 0])


@lru_cache(maxsize=1)  # a scan is counted after it was matched
def objects_of(scan: ScanFeatures) -> Integers:
    """Return (p,) the number of the small object on which each of `points_of` a scan lies, from 0 on; -1 if on none."""
    return np.asarray(_objects(points_of(scan), scan.segments.frame, scan.segments.half_length))


@compiled
def _weighted(points, objects, moved_cost):  # type: ignore[no-untyped-def]
    """Return points (p, 6) with their weights, see `SmallObjects.weighted_points`; objects (p,) see `objects_of`."""
    weighted, sizes = points.copy(), np.zeros(len(points), np.int64)
    for k in range(len(points)):
        if objects[k] >= 0:
            sizes[objects[k]] += 1
    for k in range(len(points)):
        if objects[k] >= 0:
            weighted[k, WEIGHT] = min(1.0, moved_cost * POINTS_PER_OBJECT / (MISFIT * sizes[objects[k]]))
    return weighted


@compiled
def _count(field, points, objects, pose):  # type: ignore[no-untyped-def]
    """Return the number of objects that are judged at a pose in the field, and of those that have moved.

    points, objects  (p, 6) and (p,) of a scan, see `points_of` and `objects_of`
    """
    costs = costs_of_points(field, points, pose)
    counts, totals, judged, moved = np.zeros(len(points), np.int64), np.zeros(len(points)), 0, 0
    for k in range(len(points)):
        if objects[k] >= 0 and costs[k] != UNSEEN:
            counts[objects[k]] += 1
            totals[objects[k]] += costs[k]
    for k in range(len(points)):
        if counts[k] >= MIN_JUDGED_POINTS:
            judged += 1
            moved += totals[k] > 0.5 * MISFIT * counts[k]
    return judged, moved


@compiled
def _objects(points, frames, half_lengths):  # type: ignore[no-untyped-def]
    """Return (p,) the number of the object of each point, from 0 on; -1 on walls, at walls and on other large surfaces.

    points                (p, ...) in the order of the beams
    frames, half_lengths  (n, 3), (n,) of the segments; walls are those that are too long for an object that may move
    """
    lines, on_walls = lines_of(points, frames, half_lengths), np.empty(len(points), np.bool_)
    for k in range(len(points)):
        on_walls[k] = lines[k] >= 0 and 2.0 * half_lengths[lines[k]] > MAX_SIZE
    objects, count, start = np.full(len(points), -1, np.int64), 0, 0
    for k in range(1, len(points) + 1):
        if k < len(points) and on_walls[k] == on_walls[start]:
            gap = math.hypot(points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1])
            if gap <= MAX_GAP:
                continue
        left, right, low, high = points[start, 0], points[start, 0], points[start, 1], points[start, 1]
        for i in range(start + 1, k):
            left, right = min(left, points[i, 0]), max(right, points[i, 0])
            low, high = min(low, points[i, 1]), max(high, points[i, 1])
        is_small = not on_walls[start] and math.hypot(right - left, high - low) <= MAX_SIZE
        is_alone = k - start == len(points)
        is_free = is_alone or (_is_free(points, start, start - 1) and _is_free(points, k - 1, k % len(points)))
        if is_small and is_free:
            objects[start:k] = count
            count += 1
        start = k
    return objects


@inlined
def _is_free(points, end, beside):  # type: ignore[no-untyped-def]
    """Return True if an object ends at the point `end`, given the point `beside` it in the order of the beams.

    It may go on there if both points are close together, or if the other one is on a nearer surface, which may hide the
    rest of a wall of which only a piece is seen.
    """
    gap = math.hypot(points[beside, 0] - points[end, 0], points[beside, 1] - points[end, 1])
    if gap <= LINE_DISTANCE:
        return False
    distance = math.hypot(points[end, 0], points[end, 1])
    across = points[end, 0] * points[beside, 1] - points[end, 1] * points[beside, 0]
    along = points[end, 0] * points[beside, 0] + points[end, 1] * points[beside, 1]
    is_behind = math.hypot(points[beside, 0], points[beside, 1]) > distance
    return is_behind or distance * abs(math.atan2(across, along)) > MAX_GAP

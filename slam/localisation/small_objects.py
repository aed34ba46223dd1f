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
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled, inlined

from ..geometry.segments import Floats, Integers, Segments
from ..matching.distance_field import DistanceField
from ..matching.point_costs import MISFIT, UNSEEN, costs_of_points
from ..matching.point_matcher import POINTS_PER_OBJECT
from ..matching.scan_features import ScanFeatures
from ..matching.scan_points import LINE_DISTANCE, WEIGHT, segments_of
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
        points, objects = points_of(scan).copy(), objects_of(scan)
        on_object = objects >= 0
        if on_object.any():
            sizes = np.bincount(objects[on_object])[objects[on_object]]
            points[on_object, WEIGHT] = np.minimum(1.0, self.moved_cost * POINTS_PER_OBJECT / (MISFIT * sizes))
        return points

    def add(self, scan: ScanFeatures, pose: se2.Pose, field: DistanceField, seconds: float) -> None:
        """Count the objects of a scan, `seconds` after the one before, with the base at `pose` in the field.

        An object has moved if its known points cost more than half of what points cost that fit nowhere.
        """
        objects, costs = objects_of(scan), costs_of_points(field.arrays, points_of(scan), pose)
        known = (costs != UNSEEN) & (objects >= 0)
        counts, totals = np.bincount(objects[known]), np.bincount(objects[known], costs[known])
        judged = counts >= MIN_JUDGED_POINTS
        share = min(1.0, seconds / STEADY_SECONDS)
        seen = share * float(judged.sum())
        moved = share * float((totals[judged] > 0.5 * MISFIT * counts[judged]).sum())
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
    points = points_of(scan)
    return np.asarray(_objects(points, _on_walls(points, scan.segments)))


def _on_walls(points: Floats, segments: Segments) -> NDArray[np.bool_]:
    """Return (p,) True for the points on segments that are too long for an object that may move."""
    is_long = np.append(2.0 * segments.half_length > MAX_SIZE, False)
    return np.asarray(is_long[segments_of(points, segments)])


@compiled
def _objects(points, on_walls):  # type: ignore[no-untyped-def]
    """Return (p,) the number of the object of each point, from 0 on; -1 on walls, at walls and on other large surfaces.

    points  (p, ...) in the order of the beams
    """
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

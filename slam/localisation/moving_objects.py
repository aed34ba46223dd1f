"""Match a scan without objects that have moved, if only these contradict odometry.

A person who walks beside the robot looks the same from scan to scan. Along a corridor nothing else determines the
position, so a scan fits best where the robot stands beside a person who stands, though odometry has measured that it
drives. An object that is small enough to move fits as a whole or not at all, so that it has moved is one event, which
costs MOVED_COST. Objects move in all directions, so two of them rarely look as if the robot had moved instead: each
further one costs COINCIDENCE_COST as well. Odometry is right if the scan without these objects agrees with it and costs
less, with these costs, than the whole scan where odometry must have slipped. People may walk with the robot for any
time, so odometry does not count as failing if only some small objects contradict it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import CornerPoints, Floats, Segments
from ..matching.point_costs import COARSE_SIGMA, costs_of_points
from ..matching.point_matcher import MIN_KNOWN_POINTS, Prediction
from ..matching.scan_features import ScanFeatures
from ..matching.scan_points import ScanPoints, segments_of
from .match_target import MatchTarget, ScanMatch, points_of
from .pose_predictor import information_of
from .prediction_error import PREDICTION_SIGMAS

# Cost of an object having moved since it was mapped, a few metres before. Origin: chosen, one small object in five is
# a person; not measured.
MOVED_COST = math.log(5.0)
# Cost of another object having moved by the same distance as the first one. Origin: definition, minus the logarithm of
# the share of a circle with a radius of 1 m, which a person walks in a second, that is within COARSE_SIGMA of a place.
COINCIDENCE_COST = -2.0 * math.log(COARSE_SIGMA)
# Metres, largest size of an object that may move: the width of a person with a bag. Origin: chosen; with 1.2 m, a slip
# of the wheels in fr079 counted as furniture that had moved.
MAX_SIZE = 0.8
# Cost of odometry failing from one comparison of motions to the next. Origin: chosen, it fails for long once in ten
# thousand comparisons, a kilometre, and that is decided by two of them.
FAILURE_COST = 0.5 * math.log(1e4)
# Objects at most that move with the robot for a while. Origin: chosen, a group of people; not measured.
MAX_MOVING_OBJECTS = 5
# Metres between the points of neighbouring beams of one object. Origin: chosen, the step of a walking person.
MAX_GAP = 0.3


def match_without_moving(
    match: ScanMatch, predictions: Sequence[Prediction], scan: ScanFeatures, target: MatchTarget
) -> ScanMatch | None:
    """Return the match of a scan without the objects that have moved; None if odometry has slipped instead, or agrees.

    match        of the whole scan
    predictions  those with which it was matched, that of odometry first

    Odometry agrees if its prediction makes the pose of `match` cost at most as much as an object that has moved.
    """
    usual = predictions[0]
    excess = match.points.prediction.cost_of(match.points.pose) - usual.least_cost
    if excess <= MOVED_COST:
        return None
    small = _SmallObjects(scan)
    cost, moved = 0.0, []
    for number in small.by_gain(target, usual.pose, match.points.pose):
        cost += MOVED_COST + (COINCIDENCE_COST if cost else 0.0)
        if cost >= excess:
            return None
        moved.append(number)
        static = target.match(small.removed(moved), predictions)
        known = static.known >= MIN_KNOWN_POINTS and not static.poor
        if not static.contradicts(usual) and known and static.points.cost + cost < match.points.cost:
            return static
    return None


def contradicts_without_moving(usual: Prediction, pose: se2.Pose, scan: ScanFeatures, target: MatchTarget) -> bool:
    """Return True if a scan contradicts odometry even without the MAX_MOVING_OBJECTS objects that do so most.

    People who walk with the robot contradict odometry for as long as they do so.

    usual  prediction by odometry
    pose   [x, y, heading] of the base where the whole scan fits
    """
    small = _SmallObjects(scan)
    rest = small.removed(small.by_gain(target, usual.pose, pose)[:MAX_MOVING_OBJECTS])
    slip = Prediction(pose, information_of(PREDICTION_SIGMAS), FAILURE_COST)
    return target.match(rest, [usual, slip]).contradicts(usual)


class _SmallObjects:
    """Objects of a scan that are small enough to move, numbered from 0 on."""

    def __init__(self, scan: ScanFeatures) -> None:
        self._scan, self._points = scan, points_of(scan)
        self._numbers = np.asarray(_objects(self._points, _on_walls(self._points, scan.segments)))  # -1: on none

    def by_gain(self, target: MatchTarget, usual: se2.Pose, pose: se2.Pose) -> list[int]:
        """Return the objects that fit better with the base at `pose` than at the `usual` one, the clearest first."""
        at_pose, at_usual = (costs_of_points(target.field.arrays, self._points, at) for at in (pose, usual))
        count = int(self._numbers.max(initial=-1)) + 1
        gains = np.bincount(self._numbers + 1, at_usual - at_pose, minlength=count + 1)[1:]
        return [number for number in np.argsort(-gains).tolist() if gains[number] > 0.0]

    def removed(self, objects: Sequence[int]) -> ScanFeatures:
        """Return the scan without some of the objects."""
        rows = np.asarray(_rows_before(self._points, self._scan.points.xy))
        return without_points(self._scan, np.isin(self._numbers, objects)[rows])


def _on_walls(points: Floats, segments: Segments) -> NDArray[np.bool_]:
    """Return (q,) True for the points on segments that are too long for an object that may move."""
    is_long = np.append(2.0 * segments.half_length > MAX_SIZE, False)
    return np.asarray(is_long[segments_of(points, segments)])


def without_points(scan: ScanFeatures, removed: NDArray[np.bool_]) -> ScanFeatures:
    """Return a scan without some of its points (p,), and without the segments and corners that lie on these."""
    points, segments, corners = scan.points, scan.segments, scan.corners
    rows = segments_of(points.xy, segments)
    removed_on, on = (np.bincount(rows[of] + 1, minlength=len(segments) + 1)[1:] for of in (removed, slice(None)))
    stays = 2 * removed_on <= on
    corner_stays = stays[corners.segments].all(axis=1)
    return replace(
        scan,
        segments=Segments(
            segments.frame[stays], segments.half_length[stays], segments.covariance[stays], segments.bias_slope[stays]
        ),
        corners=CornerPoints(
            corners.position[corner_stays],
            corners.covariance[corner_stays],
            (np.cumsum(stays) - 1)[corners.segments[corner_stays]],
            corners.headings[corner_stays],
        ),
        points=ScanPoints(points.xy[~removed], points.sigma),
    )


@compiled
def _objects(points, on_walls):  # type: ignore[no-untyped-def]
    """Return (q,) the number of the object of each point, from 0 on; -1 on walls and other large surfaces."""
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
        if not on_walls[start] and math.hypot(right - left, high - low) <= MAX_SIZE:
            objects[start:k] = count
            count += 1
        start = k
    return objects


@compiled
def _rows_before(kept, points):  # type: ignore[no-untyped-def]
    """Return (p,) the row of the last kept point up to each of all points (p, 2); the first one is kept."""
    rows, row = np.empty(len(points), np.int64), -1
    for k in range(len(points)):
        if row + 1 < len(kept) and points[k, 0] == kept[row + 1, 0] and points[k, 1] == kept[row + 1, 1]:
            row += 1
        rows[k] = row
    return rows

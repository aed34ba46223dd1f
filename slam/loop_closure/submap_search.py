"""Search for the pose of a submap, the points of the last keyframes, in the distance field of an old place.

All poses within the uncertainty of the estimate are tried on a coarse grid with few points. The best of them are
improved by Gauss-Newton with some more points, and those that fit then with all points. The match counts in both
directions: the points of the submap must fit the old place wherever it was seen, and the points of the old place must
fit the submap wherever that was seen. So a wall that should have hidden what was seen behind it speaks against a pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled
from drivers.immutable import immutable

from ..geometry.degeneracy import MIN_INFORMATION
from ..geometry.segments import Floats
from ..geometry.surroundings import ROOM_SIZE
from ..matching.distance_field import DistanceField, facing_grid
from ..matching.offset_tiles import FIELD_CELL, MAX_DISTANCE
from ..matching.point_costs import COARSE_SIGMA, MISFIT, SEARCH_TURN_STEP, UNSEEN, cost_at
from ..matching.point_matcher import MAX_SEARCH_POINTS, Prediction, match_from, point_cost
from ..matching.scan_points import FINE_SIGMA, subsample

# Metres of driving whose keyframes are the submap. Looks farther apart have no point in common.
# Origin: definition.
SUBMAP_LENGTH = ROOM_SIZE
# Metres of driving from which on the robot has come back to a place, and has not just stayed there: the recent submap
# and that of the old place do not overlap then. Origin: definition.
REVISIT_GAP = 2.0 * SUBMAP_LENGTH
# Metres between the poses of the coarse grid; the radians are those of the search for a scan.
# Origin: chosen, Gauss-Newton corrects more than half a step.
SEARCH_STEP = 0.3
# Poses of the grid that are improved. Origin: chosen, for speed; not measured.
MAX_REFINED = 8
# Points of each submap with which it is decided whether a pose is improved with all of them. Origin: measured, on 290
# searches in three recordings the matches that fit are the same with 400, 600 and 800 as without that decision, which
# halves the time.
MAX_SCREENING_POINTS = 600
# Fit of these points from which a pose is improved with all of them. Origin: definition, with less a match is less
# likely than a place that was not seen.
MIN_SCREENING_FIT = 1.0 - UNSEEN / MISFIT
# Metres and radians: standard deviation added to a match's own, from the submaps' own distortion, which is that of a
# point, and its angle over the length of a submap.
DISTORTION_SIGMAS = np.array([FINE_SIGMA, FINE_SIGMA, FINE_SIGMA / SUBMAP_LENGTH])
# Metres between two robot positions from which on they are different places. Origin: definition, Gauss-Newton does not
# lead from one to the other.
DISTINCT_SHIFT = MAX_DISTANCE
# Radians, likewise; either suffices. Origin: chosen; not measured.
DISTINCT_TURN = math.radians(10.0)
# Information (3, 3) of a prediction that says nothing. Origin: definition.
NO_PRIOR = MIN_INFORMATION * np.eye(3)
# Information (3, 3) that is added to that of a match, so that it has an inverse in directions that no point determines.
# Origin: numerical, standard deviations of 10 m and 10 radians.
UNDETERMINED = 1e-2 * np.eye(3)


@immutable
class Submap:
    """Points (p, 6) of some keyframes with their normals, in the frame of one of them, and their distance field."""

    points: Floats
    field: DistanceField


@immutable
class SubmapMatch:
    """Pose of a submap relative to an old one.

    pose        [x, y, heading] of the submap's frame in that of the old submap
    covariance  (3, 3) in the submap's frame
    fit         share of the points in seen space that fit, the smaller of both directions
    known       share of the submap's points in space that the old submap has seen
    """

    pose: se2.Pose
    covariance: Floats
    fit: float
    known: float

    @property
    def quality(self) -> float:
        """Log-likelihood ratio per point in seen space to a place that was not seen; see UNSEEN of `point_costs`."""
        return MISFIT * self.fit - (MISFIT - UNSEEN)

    @property
    def score(self) -> float:
        """The same per point of the submap."""
        return self.known * self.quality


def build_submap(poses: Floats, points: Sequence[NDArray[np.floating]], half_width: float) -> Submap:
    """Build a submap from keyframes at `poses` (k, 3) in its frame, each with points (p, 6) in its own."""
    field = DistanceField.empty(np.zeros(2), half_width)
    field.insert_scans(poses, points)
    return Submap(_moved(poses, points), field.completed())


def _moved(poses: Floats, scans: Sequence[NDArray[np.floating]]) -> Floats:
    """Return the points (p, 6) with normals of scans in the frames of their poses (k, 3), as one array (n, 6)."""
    lengths, points = [len(scan) for scan in scans], np.concatenate(scans, dtype=np.float64)
    c, s = (np.repeat([f(heading) for heading in poses[:, 2].tolist()], lengths) for f in (math.cos, math.sin))
    x, y, normal_x, normal_y = points.T[:4]
    result = np.empty_like(points)
    result[:, 0] = np.repeat(poses[:, 0], lengths) + c * x - s * y
    result[:, 1] = np.repeat(poses[:, 1], lengths) + s * x + c * y
    result[:, 2], result[:, 3] = c * normal_x - s * normal_y, s * normal_x + c * normal_y
    result[:, 4:] = points[:, 4:]
    return result


def search_submap(submap: Submap, old: Submap, prediction: se2.Pose, reach: float, turn: float) -> list[SubmapMatch]:
    """Return the distinct poses of a submap in an old one at which both fit, by descending score.

    prediction  [x, y, heading] of the submap's frame in that of the old submap, in the middle of the search
    reach       metres that are searched ahead, behind and beside it
    turn        radians that are searched to either side
    """
    reach, turn = max(SEARCH_STEP, reach), min(math.pi, max(SEARCH_TURN_STEP, turn))
    few = np.ascontiguousarray(subsample(submap.points, MAX_SEARCH_POINTS))  # strided: compiled for separately
    costs = _grid_costs(old.field.arrays, few, prediction, reach, turn)
    low = np.flatnonzero(costs == lowest_around(costs))
    low = low[np.argsort(costs.ravel()[low], kind="stable")[:MAX_REFINED]]
    turns, steps = (costs.shape[0] - 1) // 2, (costs.shape[1] - 1) // 2
    some, of_old = (
        np.ascontiguousarray(subsample(points, MAX_SCREENING_POINTS)) for points in (submap.points, old.points)
    )
    found: list[SubmapMatch] = []
    for k, i, j in np.column_stack(np.unravel_index(low, costs.shape)):
        offset = np.array([(i - steps) * SEARCH_STEP, (j - steps) * SEARCH_STEP, (k - turns) * SEARCH_TURN_STEP])
        start = se2.compose(prediction, offset)
        near = _screen(submap.field, old.field, some, of_old, start)
        if near is None:
            continue
        match = match_from(old.field, submap.points, near, Prediction(near, NO_PRIOR))
        if all(are_distinct(match.pose, other.pose) for other in found):
            found.append(_judge(submap, old, match.pose, match.information))
    return sorted(found, key=lambda match: -match.score)


def lowest_around(costs: Floats) -> Floats:
    """Return the lowest of the costs (...) of each pose of a grid and its neighbours, diagonal ones too."""
    lowest = costs
    for axis in range(costs.ndim):
        along = np.moveaxis(lowest, axis, 0)
        lowest = np.moveaxis(along.copy(), 0, axis)
        result = np.moveaxis(lowest, axis, 0)
        np.minimum(result[1:], along[:-1], out=result[1:])
        np.minimum(result[:-1], along[1:], out=result[:-1])
    return lowest


def _screen(
    field: DistanceField, old_field: DistanceField, points: Floats, old_points: Floats, start: se2.Pose
) -> se2.Pose | None:
    """Return the pose that Gauss-Newton finds from `start` with some points of a submap, if those of both fit there.

    The submap's points are matched with the wide kernel only, which decides to which pose Gauss-Newton leads.
    """
    match = match_from(old_field, points, start, Prediction(start, NO_PRIOR), (COARSE_SIGMA,))
    if match.fit < MIN_SCREENING_FIT:
        return None
    fits = point_cost(field, old_points, se2.inverse(match.pose))[1] >= MIN_SCREENING_FIT
    return match.pose if fits else None


def improve(submap: Submap, old: Submap, start: se2.Pose) -> SubmapMatch:
    """Return the pose of a submap in an old one that Gauss-Newton finds from `start`."""
    match = match_from(old.field, submap.points, start, Prediction(start, NO_PRIOR))
    return _judge(submap, old, match.pose, match.information)


def _judge(submap: Submap, old: Submap, pose: se2.Pose, information: Floats) -> SubmapMatch:
    """Compare a submap and an old one in both directions at a pose."""
    _, fit, known = point_cost(old.field, submap.points, pose)
    _, reverse, _ = point_cost(submap.field, old.points, se2.inverse(pose))
    of_points = np.asarray(np.linalg.inv(information + UNDETERMINED), dtype=np.float64)
    covariance = of_points + np.diag(DISTORTION_SIGMAS**2)
    return SubmapMatch(pose, covariance, min(fit, reverse), known / max(1, len(submap.points)))


def are_distinct(pose: se2.Pose, other: se2.Pose) -> bool:
    """Return True if two poses are different places."""
    x, y, turn = se2.between(pose, other)
    return bool(math.hypot(x, y) > DISTINCT_SHIFT or abs(turn) > DISTINCT_TURN)


@compiled
def _grid_costs(field, points, prediction, reach, turn):  # type: ignore[no-untyped-def]
    """Return the costs (t, n, n) of the poses on a grid around the prediction, in its axes.

    All positions are tried with one point after the other: its direction is computed once, and it stays near in memory.
    """
    turns, steps = math.ceil(turn / SEARCH_TURN_STEP), math.ceil(reach / SEARCH_STEP)
    costs = np.zeros((2 * turns + 1, 2 * steps + 1, 2 * steps + 1))
    step = SEARCH_STEP / FIELD_CELL
    step_x, step_y = math.cos(prediction[2]) * step, math.sin(prediction[2]) * step
    start_x, start_y = (prediction[0] - field[0][0]) / FIELD_CELL, (prediction[1] - field[0][1]) / FIELD_CELL
    for k in range(2 * turns + 1):
        heading = prediction[2] + (k - turns) * SEARCH_TURN_STEP
        c, s = math.cos(heading), math.sin(heading)
        for m in range(len(points)):
            grid = facing_grid(c * points[m, 2] - s * points[m, 3], s * points[m, 2] + c * points[m, 3])
            x = start_x + (c * points[m, 0] - s * points[m, 1]) / FIELD_CELL
            y = start_y + (s * points[m, 0] + c * points[m, 1]) / FIELD_CELL
            for i in range(-steps, steps + 1):
                for j in range(-steps, steps + 1):
                    at_x, at_y = x + i * step_x - j * step_y, y + i * step_y + j * step_x
                    costs[k, i + steps, j + steps] += cost_at(field, grid, at_x, at_y)[0]
    return costs

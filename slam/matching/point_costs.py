"""Costs of a scan's points at poses in the distance field, and the search for the pose with the lowest cost.

The cost of a point is minus the logarithm of its likelihood; see `point_matcher`.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled, inlined
from drivers.small_matrices import quadratic_form

from ..mapping.sight_lines import MIN_DEPTH
from .distance_field import ALL_POINTS, facing_grid, nearest_distance
from .free_space import NEW_SURFACE, is_seen
from .offset_tiles import FIELD_CELL, MAX_DISTANCE, MAX_SQUARED, OFFSET_UNIT, metres, offset_at, squared_length
from .scan_points import FINE_SIGMA, WEIGHT

# Metres, scale of the wide kernel. Origin: chosen, a fifth of MAX_DISTANCE; not measured.
COARSE_SIGMA = MAX_DISTANCE / 5.0
# Cost of a squared unit of offsets: squares are compared without taking their roots. Origin: definition.
COST_OF_SQUARE = 0.5 * (OFFSET_UNIT / COARSE_SIGMA) ** 2
# Cost of a point that fits nowhere. Origin: chosen, it is then 2.8 standard deviations off.
MISFIT = 4.0
# Cost from which on a point is on no known surface. Origin: definition, as for points that enter the field.
NEW_SURFACE_COST = 0.5 * (NEW_SURFACE / COARSE_SIGMA) ** 2
# Cost of a point in a cell that was not seen. Origin: definition, the mean of fitting and not fitting.
UNSEEN = 0.5 * MISFIT
# Metres from a known point within which a beam passes through its surface. Origin: definition, the field's resolution.
ON_SURFACE = 0.5 * math.sqrt(2.0) * FIELD_CELL
# Metres and radians between searched poses. Origin: chosen, Gauss-Newton reaches more than half a step.
SEARCH_STEP = 0.15
SEARCH_TURN_STEP = math.radians(3.0)  # Origin: as SEARCH_STEP.


@compiled
def points_cost(field, points, pose):  # type: ignore[no-untyped-def]
    """Return cost, fit and known points of points (p, 6) with normals at a pose; see `point_matcher.PointMatch`."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    total, of_known, known = 0.0, 0.0, 0
    for k in range(len(points)):
        cost, evidence = point_cost(field, points, k, pose, c, s)
        weight = points[k, WEIGHT]
        total += weight * cost
        if evidence:
            of_known += weight * cost
            known += 1
    return total, 1.0 - of_known / (MISFIT * max(known, 1)), known


@compiled
def fine_cost(field, points, pose):  # type: ignore[no-untyped-def]
    """Return the cost of points (p, 6) with normals at a pose that is the result of a match.

    Such a pose is accurate, so the scale of the offsets is FINE_SIGMA. They are measured across the surfaces: the
    mapped points of a distant wall are decimetres apart, and a scan from where one of them was mapped would always fit
    best.
    """
    total = 0.0
    for k in range(len(points)):
        total += points[k, WEIGHT] * _fine_cost(field, points[k], pose)[0]
    return total


@compiled
def excess_cost(field, points, pose, other):  # type: ignore[no-untyped-def]
    """Return by how much more points (p, 6) with normals cost at a pose than at another one, as for `fine_cost`.

    Only points that are in seen space at both poses count.
    """
    excess = 0.0
    for k in range(len(points)):
        cost, evidence = _fine_cost(field, points[k], pose)
        other_cost, other_evidence = _fine_cost(field, points[k], other)
        if evidence and other_evidence:
            excess += points[k, WEIGHT] * (cost - other_cost)
    return excess


@inlined
def _fine_cost(field, point, pose):  # type: ignore[no-untyped-def]
    """Return the cost of a point at a pose by its offset across the surface, and if it is in seen space."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x = (pose[0] + c * point[0] - s * point[1] - field[0][0]) / FIELD_CELL
    y = (pose[1] + s * point[0] + c * point[1] - field[0][1]) / FIELD_CELL
    normal_x, normal_y = c * point[2] - s * point[3], s * point[2] + c * point[3]
    grid = facing_grid(normal_x, normal_y)
    cost, evidence = cost_at(field, grid, x, y)
    if not evidence or cost >= MISFIT:
        return cost, evidence
    row, column = math.floor(x), math.floor(y)
    dx, dy = metres(offset_at(field[1], field[2], grid, row, column))
    dx, dy = dx + FIELD_CELL * (x - row - 0.5), dy + FIELD_CELL * (y - column - 0.5)
    squared = dx * dx + dy * dy if grid == ALL_POINTS else (normal_x * dx + normal_y * dy) ** 2
    return min(MISFIT, 0.5 * squared / FINE_SIGMA**2), True


@compiled
def costs_of_points(field, points, pose):  # type: ignore[no-untyped-def]
    """Return the cost (p,) of each of points (p, 6) with normals at a pose."""
    c, s, costs = math.cos(pose[2]), math.sin(pose[2]), np.empty(len(points))
    for k in range(len(points)):
        costs[k] = point_cost(field, points, k, pose, c, s)[0]
    return costs


@compiled
def crossing_beams(field, points, pose):  # type: ignore[no-untyped-def]
    """Return how many beams to points (p, 6) pass through known surfaces at a pose, before they reach theirs."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    start_x, start_y = (pose[0] - field[0][0]) / FIELD_CELL, (pose[1] - field[0][1]) / FIELD_CELL
    count = 0
    for k in range(len(points)):
        length = math.hypot(points[k, 0], points[k, 1])
        if length <= MIN_DEPTH:
            continue
        step_x = (c * points[k, 0] - s * points[k, 1]) / (length * FIELD_CELL)
        step_y = (s * points[k, 0] + c * points[k, 1]) / (length * FIELD_CELL)
        at = MIN_DEPTH
        while at < length - MIN_DEPTH:
            distance = nearest_distance(field, ALL_POINTS, start_x + at * step_x, start_y + at * step_y)
            if distance < ON_SURFACE:
                count += 1
                break
            at += max(FIELD_CELL, distance - FIELD_CELL)
    return count


@inlined
def point_cost(field, points, k, pose, c, s):  # type: ignore[no-untyped-def]
    """Return the cost of point k at a pose with cosine `c` and sine `s`, and if it is in seen space."""
    x = (pose[0] + c * points[k, 0] - s * points[k, 1] - field[0][0]) / FIELD_CELL
    y = (pose[1] + s * points[k, 0] + c * points[k, 1] - field[0][1]) / FIELD_CELL
    grid = facing_grid(c * points[k, 2] - s * points[k, 3], s * points[k, 2] + c * points[k, 3])
    return cost_at(field, grid, x, y)


@inlined
def cost_at(field, grid, x, y):  # type: ignore[no-untyped-def]
    """Return the cost of a point at (x, y), in cells, on a surface that faces as `grid` does, and if it is known.

    The most frequent case is decided first: this is the innermost function of all searches.
    """
    _, tile_of, tiles, seen = field
    if not is_seen(seen, x, y):
        return UNSEEN, False
    row, column = math.floor(x), math.floor(y)
    squared = squared_length(offset_at(tile_of, tiles, grid, row, column))
    if squared < MAX_SQUARED:
        return min(COST_OF_SQUARE * squared, MISFIT), True
    # Beside a surface that faces elsewhere, a point may be on the other side of a wall.
    known = squared_length(offset_at(tile_of, tiles, ALL_POINTS, row, column)) >= MAX_SQUARED
    return (MISFIT if known else UNSEEN), known


@compiled
def search_grid(field, points, share, prediction, prior, kernel, shift, turn):  # type: ignore[no-untyped-def]
    """Return the pose with the lowest cost on a grid around the prediction.

    points             (p, 6) with normals, in the base's frame
    share              times that the cost of each point counts
    prediction, prior  pose (3,) in the map and its information (3, 3), with a Cauchy kernel of the scale `kernel`
    shift, turn        metres and radians from the prediction up to which poses are tried
    """
    best, turned, facing = prediction.copy(), np.empty((len(points), 2)), np.empty(len(points), np.int64)
    lowest = share * points_cost(field, points, best)[0]
    _search(field, points, share, prediction, prior, kernel, shift, turn, best, lowest, turned, facing)
    return best


@inlined
def _search(  # type: ignore[no-untyped-def]
    field, points, share, prediction, prior, kernel, shift, turn, best, lowest, turned, facing
):
    """Replace the pose `best`, whose cost is `lowest`, by the best one of the grid; see `search_grid`.

    `turned` (p, 2) and `facing` (p,) are overwritten: of all that a point's cost depends on, only the point's place
    differs between poses of the same heading.
    """
    turns, steps = math.ceil(turn / SEARCH_TURN_STEP), math.ceil(shift / SEARCH_STEP)
    c, s = math.cos(prediction[2]), math.sin(prediction[2])
    # From the prediction outwards: a low cost found early ends the others' sums early.
    for k in range(2 * turns + 1):
        angle = _outwards(k) * SEARCH_TURN_STEP
        heading = prediction[2] + angle
        turn_c, turn_s = math.cos(angle), math.sin(angle)
        _turn(points, math.cos(heading), math.sin(heading), turned, facing)
        for i in range(2 * steps + 1):
            for j in range(2 * steps + 1):
                x, y = _outwards(i) * SEARCH_STEP, _outwards(j) * SEARCH_STEP
                ahead, left = turn_c * x + turn_s * y, turn_c * y - turn_s * x
                cost = 0.5 * kernel**2 * math.log(1.0 + quadratic_form(prior, ahead, left, angle) / kernel**2)
                if cost >= lowest:
                    continue
                pose_x, pose_y = prediction[0] + c * x - s * y, prediction[1] + s * x + c * y
                cost += share * _cost_below(field, points, turned, facing, pose_x, pose_y, (lowest - cost) / share)
                if cost < lowest:
                    lowest = cost
                    best[0], best[1], best[2] = pose_x, pose_y, heading


@inlined
def _turn(points, c, s, turned, facing):  # type: ignore[no-untyped-def]
    """Set `turned` (p, 2), the turned points in cells, and the grids (p,) that they face."""
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        turned[k, 0], turned[k, 1] = (c * x - s * y) / FIELD_CELL, (s * x + c * y) / FIELD_CELL
        facing[k] = facing_grid(c * points[k, 2] - s * points[k, 3], s * points[k, 2] + c * points[k, 3])


@inlined
def _cost_below(field, points, turned, facing, pose_x, pose_y, limit):  # type: ignore[no-untyped-def]
    """Return the cost of points, see `_turn`, at a position, or any value from `limit` on if it reaches that."""
    total, x, y = 0.0, (pose_x - field[0][0]) / FIELD_CELL, (pose_y - field[0][1]) / FIELD_CELL
    for k in range(len(turned)):
        total += points[k, WEIGHT] * cost_at(field, facing[k], x + turned[k, 0], y + turned[k, 1])[0]
        if total >= limit:
            break
    return total


@inlined
def _outwards(number):  # type: ignore[no-untyped-def]
    """Return 0, 1, -1, 2, -2, ... for the numbers from 0 on."""
    return (number + 1) // 2 if number % 2 == 1 else -(number // 2)

"""Walls of a plan as a lidar would see them: visible faces with a prior covariance, and views from places in the plan.

A drawing shows lines; a map has walls that are seen from one side. Which side of which part of a line can be seen is
found by casting rays from places in free space. What the rays meet are views: they take the place of scans where a map
must show what was seen, in relocalisation, in matching, and in the comparison of maps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable
from features.normal_limits import NORMAL_LIMIT

from ..geometry.segments import Floats, Integers, Segments
from ..geometry.surroundings import DOOR_WIDTH
from .landmarks import Landmarks
from .map_features import MapWalls
from .plan import Plan
from .plan_views import RaysFromPlace, cast_views
from .ray_casting import pieces_near_line
from .wall_cells import END_ERROR_CELLS, WALL_CELL, cells_between

# Metres between two pieces of one wall: a double door. Origin: definition.
MAX_PIECE_GAP = 2.0 * DOOR_WIDTH
# Metres of a piece that has a direction of its own: what is shorter may be an error of the end of another one.
MIN_PIECE = END_ERROR_CELLS * WALL_CELL
# Metres of a face that a view must show, more than by what its ends may be wrong.
MIN_VISIBLE = MIN_PIECE + WALL_CELL
# Rays that must meet a face to show it: fewer may pass through a gap of the drawing by chance. Origin: definition, a
# line.
MIN_RAYS = 3
# Seconds: stamp of the last view of a plan, where views take the place of scans. It is so long before any recording
# that no odometry continues it. Origin: definition.
VIEWS_END = -1000.0
# Metres: standard deviation of the noise that is added to the distances of the points of a view. Without noise, points
# on a line along the border of grid cells would all be in the cells on one side, which rounding would choose; points of
# a scan scatter over both. Origin: chosen, the noise of usual lidars.
VIEW_NOISE = 0.01


@immutable
class PlanView:
    """View from a place in the plan, with the axes of the plan.

    position  (2,) metres
    points    (p, 2) that rays meet, from there, in counter-clockwise order, with the noise of a lidar
    segments  visible parts of walls, from there, with the covariance of the plan's walls
    walls     (s,) row of the wall of each segment
    """

    position: Floats
    points: Floats
    segments: Segments
    walls: Integers

    @property
    def pose(self) -> se2.Pose:
        """Pose [x, y, heading] of the view in the plan."""
        return np.array([*self.position.tolist(), 0.0])


@immutable
class PlanMap:
    """Visible walls of a plan and views of them.

    plan    from which it was made
    walls   with the prior covariance of each at its frame, which is at its middle; `observations` are the views
    hidden  (h, 2, 2) end points of the faces that no view shows, as those close behind other ones; they could be seen
            from the left of the way from the first point to the second one
    views   in the order of a short tour
    """

    plan: Plan
    walls: MapWalls
    hidden: Floats
    views: Sequence[PlanView]


def build_plan_map(plan: Plan, sigmas: tuple[float, float]) -> PlanMap:
    """Return the walls of a plan that can be seen, with views.

    sigmas  standard deviations of a wall across (metres) and of its heading (radians), beside those that follow from
            the plan's precision

    Without views there are no walls: the plan has no place that a robot fits in.
    """
    frames, members, spans = _merge_pieces(plan)
    casts = cast_views(plan)
    covariance = _covariances(spans, sigmas, plan.precision)
    seen = [_visible_parts(cast, plan, frames, members) for cast in casts]
    random = np.random.default_rng(0)
    covered: list[set[int]] = [set() for _ in frames]
    for _, parts in seen:
        for wall, low, high in parts:
            covered[wall] |= cells_between(low, high)
    kept = [wall for wall, cells in enumerate(covered) if cells]
    number = {wall: row for row, wall in enumerate(kept)}
    seen_frames, seen_covariance, views = frames[kept], covariance[kept], []
    for cast, (points, parts) in zip(casts, seen, strict=True):
        parts = [(number[wall], low, high) for wall, low, high in parts if wall in number]
        views.append(_view(cast.position, _noisy(points, random), parts, seen_frames, seen_covariance))
    walls = _walls(seen_frames, [covered[wall] for wall in kept], spans[kept], seen_covariance, views)
    rest = np.flatnonzero([not cells for cells in covered])
    hidden = se2.transform(frames[rest][:, None], np.stack([spans[rest], np.zeros((len(rest), 2))], axis=-1))
    return PlanMap(plan, walls, np.asarray(hidden).reshape(-1, 2, 2), views)


def _merge_pieces(plan: Plan) -> tuple[Floats, Integers, Floats]:
    """Join pieces on one line, without large gaps, into faces.

    Returns their frames (m, 3), x along the wall, which is seen from y > 0, with the origin in the middle; the face
    (n, 2) of each piece on its left and on its right, -1 for a side that is not seen; and the extents (m, 2) of the
    faces along their frames.
    """
    pieces = np.concatenate([plan.segments, plan.segments[~plan.one_sided][:, ::-1]])
    of_piece = np.concatenate([np.arange(len(plan.segments)), np.flatnonzero(~plan.one_sided)])
    side = np.repeat([0, 1], [len(plan.segments), len(pieces) - len(plan.segments)])
    along = pieces[:, 1] - pieces[:, 0]
    length, heading = np.hypot(along[:, 0], along[:, 1]), np.arctan2(along[:, 1], along[:, 0])
    tolerance = NORMAL_LIMIT * plan.precision
    members, frames, spans = np.full((len(plan.segments), 2), -1), list[Floats](), list[Floats]()
    left = length >= MIN_PIECE
    for longest in np.argsort(-length, kind="stable").tolist():
        if not left[longest]:
            continue
        chosen = _on_line(pieces, heading, left, longest, tolerance)
        left[chosen] = False
        frame = _line_through(pieces[chosen], length[chosen], heading[longest])
        ends = se2.transform(se2.inverse(frame), pieces[chosen])[..., 0]
        middle = 0.5 * float(ends.min() + ends.max())
        members[of_piece[chosen], side[chosen]] = len(frames)
        frames.append(se2.compose(frame, np.array([middle, 0.0, 0.0])))
        spans.append(np.array([ends.min(), ends.max()]) - middle)
    return np.array(frames).reshape(-1, 3), members, np.array(spans).reshape(-1, 2)


def _on_line(pieces: Floats, heading: Floats, left: NDArray[np.bool_], first: int, tolerance: float) -> Integers:
    """Return the pieces on the line of the piece `first` without a large gap between them and it."""
    start = pieces[first, 0]
    across = np.array([-math.sin(heading[first]), math.cos(heading[first])])
    # Most pieces of a large plan start farther away; twice the tolerance, so that rounding does not matter.
    rows = pieces_near_line(pieces, left, start, across, 2.0 * tolerance)
    frame = np.array([start[0], start[1], heading[first]])
    ends = se2.transform(se2.inverse(frame), pieces[rows])
    near = (np.abs(ends[..., 1]).max(axis=1) <= tolerance) & (np.cos(heading[rows] - heading[first]) > 0.0)
    rows, ends = rows[near], ends[near]
    order = np.argsort(ends[..., 0].min(axis=1), kind="stable")
    rows, ends = rows[order], ends[order]
    low, high = ends[..., 0].min(axis=1), ends[..., 0].max(axis=1)
    reached = np.maximum.accumulate(high)
    run = np.concatenate([[0], np.cumsum(low[1:] - reached[:-1] > MAX_PIECE_GAP)])
    return np.asarray(rows[run == run[rows == first]])


def _line_through(pieces: Floats, length: Floats, heading: float) -> se2.Pose:
    """Return a frame on the line through pieces (k, 2, 2), weighted by their length, nearly along a heading."""
    points, weight = pieces.reshape(-1, 2), np.repeat(length, 2)
    if len(pieces) == 1:  # most pieces of a large plan
        return np.array([*points.mean(axis=0).tolist(), heading])
    middle = np.average(points, axis=0, weights=weight)
    scatter = (points - middle).T @ (weight[:, None] * (points - middle))
    axis = np.linalg.eigh(scatter)[1][:, 1]
    axis = axis if axis @ [math.cos(heading), math.sin(heading)] > 0.0 else -axis
    return np.array([*middle.tolist(), math.atan2(axis[1], axis[0])])


def _covariances(spans: Floats, sigmas: tuple[float, float], precision: float) -> Floats:
    """Return the covariance (m, 2, 2) of offset and heading of faces at their middles.

    spans      (m, 2) extents, metres
    sigmas     standard deviations of any wall
    precision  of the points of a line in the file, metres

    The heading of a line through two points is the less certain the shorter it is: that of a short wall in a grid map
    is hardly known.
    """
    result = np.zeros((len(spans), 2, 2))
    result[:, 0, 0] = sigmas[0] ** 2 + precision**2
    result[:, 1, 1] = sigmas[1] ** 2 + 2.0 * (precision / np.maximum(np.ptp(spans, axis=1), MIN_PIECE)) ** 2
    return result


def _visible_parts(
    rays: RaysFromPlace, plan: Plan, frames: Floats, members: Integers
) -> tuple[Floats, list[tuple[int, float, float]]]:
    """Return the points (p, 2) that rays from a place meet, and the visible parts of faces: face, begin and end."""
    met = rays.piece >= 0
    piece, bearing, distance = rays.piece[met], rays.bearing[met], rays.distance[met]
    points = rays.position + distance[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    start, end = plan.segments[piece, 0], plan.segments[piece, 1]
    along, beam = end - start, rays.position - start
    on_left = along[:, 0] * beam[:, 1] - along[:, 1] * beam[:, 0] > 0.0
    face = members[piece, np.where(on_left, 0, 1)]
    visible = on_left | ~plan.one_sided[piece]
    parts = []
    for one in np.unique(piece[face >= 0]).tolist():
        rows = np.flatnonzero((piece == one) & (face >= 0))
        position = se2.transform(se2.inverse(frames[face[rows[0]]]), points[rows])[:, 0]
        if len(rows) >= MIN_RAYS and np.ptp(position) >= MIN_VISIBLE:
            parts.append((int(face[rows[0]]), float(position.min()), float(position.max())))
    return points[visible] - rays.position, parts


def _noisy(points: Floats, random: np.random.Generator) -> Floats:
    """Return points (p, 2), given from a place, as a lidar there would measure them."""
    distance = np.hypot(points[:, 0], points[:, 1])
    return np.asarray(points * (1.0 + random.normal(0.0, VIEW_NOISE, len(points)) / distance)[:, None])


def _view(
    position: Floats, points: Floats, parts: list[tuple[int, float, float]], frames: Floats, covariance: Floats
) -> PlanView:
    """Return a view of parts of walls with some frames (m, 3) and covariances (m, 2, 2)."""
    walls = np.array([wall for wall, _, _ in parts], dtype=np.int64)
    ends = np.array([part[1:] for part in parts], dtype=np.float64).reshape(-1, 2)
    middle, half = ends.mean(axis=1), 0.5 * (ends[:, 1] - ends[:, 0])
    zero = np.zeros(len(walls))
    frame = se2.compose(frames[walls], np.column_stack([middle, zero, zero])).reshape(-1, 3)
    segments = Segments(frame - [*position.tolist(), 0.0], half, covariance[walls])
    return PlanView(position, points, segments, walls)


def _walls(
    frames: Floats, covered: Sequence[set[int]], spans: Floats, covariance: Floats, views: Sequence[PlanView]
) -> MapWalls:
    """Return the faces as walls with their visible pieces and their covariances (m, 2, 2)."""
    landmarks = Landmarks()
    for frame, cells, span in zip(frames, covered, spans, strict=True):
        wall = landmarks.add_wall(frame, 0.5 * float(span[1] - span[0]), 0)
        landmarks.covered[wall] = frozenset(cells)
        landmarks.trim_extent(wall)
    rows = landmarks.walls.rows
    observed = np.bincount(np.concatenate([np.zeros(0, np.int64), *(v.walls for v in views)]), minlength=len(rows))
    return MapWalls(
        identity=np.arange(len(rows)),
        frame=rows["frame"].copy(),
        low=rows["low"].copy(),
        high=rows["high"].copy(),
        observations=observed,
        covariance=covariance,
        pieces=tuple(landmarks.pieces_of_walls(np.arange(len(rows)))),
    )

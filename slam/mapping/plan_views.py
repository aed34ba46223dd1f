"""Places in a plan from which rays are cast, and what the rays meet."""

from __future__ import annotations

import math

import numpy as np

from drivers.immutable import immutable
from features.normal_limits import NORMAL_LIMIT

from ..errors import MapError
from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import CORRIDOR_LENGTH
from .plan import Plan
from .ray_casting import SegmentIndex, cast_rays, mark_near, tour

# Metres between places. Origin: chosen, less than half of the distance within which views show mostly the same
# surfaces.
VIEWPOINT_SPACING = 1.5
# Metres of free space around a place: a robot fits in, and the inside of a wall has none. Origin: chosen; not measured.
VIEWPOINT_CLEARANCE = 0.35
# Metres within which a place of the file is near enough to another one. Origin: definition, as the spacing.
SAME_PLACE = 0.5 * VIEWPOINT_SPACING
# Rays from a place. Origin: definition, one per degree.
RAYS = 360
# Metres that a ray reaches: farther walls are seen from nearer places. Origin: definition.
RAY_REACH = CORRIDOR_LENGTH
# Share of the rays from a place that must meet a visible side: otherwise it is outside of the building.
# Origin: definition, most of them.
MIN_MEETING = 0.5
# Views of a plan: 45000 m2 of free space in a drawing, 20000 m2 in a grid map. Origin: chosen, eight times as many as
# of a plan with which a short run took 13 s and 600 MB.
MAX_VIEWS = 20_000
# Places from which rays are cast at once. Origin: numerical, so that their arrays take little memory.
CHUNK = 1024


@immutable
class RaysFromPlace:
    """Rays from a place.

    position  (2,) metres
    bearing   (r,) radians, ascending
    distance  (r,) metres to the nearest piece; infinite if there is none
    piece     (r,) its row, -1 if there is none
    """

    position: Floats
    bearing: Floats
    distance: Floats
    piece: Integers


def cast_views(plan: Plan) -> list[RaysFromPlace]:
    """Cast rays from the places of a plan, or from a square grid, and return those of places inside, as a short tour.

    A place of the grid is between the lines, with VIEWPOINT_CLEARANCE around it. A place is inside if most of its rays
    meet a piece, and from the side on which it can be seen. Of the two sides of a thin wall, which may be on one line
    within the precision of the plan, a ray meets the one that faces the place. Raises MapError if the plan has too much
    free space.
    """
    if not len(plan.segments):
        return []
    places = find_viewpoints(plan) if plan.viewpoints is None else _thinned(plan.viewpoints)
    index, bearing = SegmentIndex.of(plan.segments), 2.0 * math.pi * (np.arange(RAYS) + 0.5) / RAYS
    directions = np.column_stack([np.cos(bearing), np.sin(bearing)])
    thickness, least = NORMAL_LIMIT * plan.precision, math.ceil(MIN_MEETING * RAYS)
    casts: list[RaysFromPlace] = []
    for first in range(0, len(places), CHUNK):
        some = places[first : first + CHUNK]
        hits = cast_rays(index, plan.one_sided, thickness, some, directions, RAY_REACH, least)
        inside = np.flatnonzero(hits.visible >= least).tolist()
        casts += [RaysFromPlace(some[k], bearing, hits.distance[k].copy(), hits.row[k].copy()) for k in inside]
        if len(casts) > MAX_VIEWS:
            width, height = plan.size
            raise MapError(
                f"{plan.name}: has room for more than {MAX_VIEWS} views in {width:.4g} m x {height:.4g} m; state the "
                "unit of a drawing with --plan-unit, or use a part of the plan"
            )
    return [casts[k] for k in tour(np.array([cast.position for cast in casts]).reshape(-1, 2)).tolist()]


def find_viewpoints(plan: Plan) -> Floats:
    """Return places (k, 2) between the lines of a drawing, on a square grid, from which rays may meet some of them."""
    points = plan.segments.reshape(-1, 2)
    low, high = points.min(axis=0), points.max(axis=0)
    axes = [np.arange(a + 0.5 * VIEWPOINT_SPACING, b, VIEWPOINT_SPACING) for a, b in zip(low, high, strict=True)]
    grid = low + 0.5 * VIEWPOINT_SPACING, VIEWPOINT_SPACING, (len(axes[0]), len(axes[1]))
    near = mark_near(plan.segments, *grid, RAY_REACH)
    columns, rows = np.nonzero((near & ~mark_near(plan.segments, *grid, VIEWPOINT_CLEARANCE)).T)[::-1]
    return np.column_stack([axes[0][columns], axes[1][rows]])


def _thinned(viewpoints: Floats) -> Floats:
    """Return places of which no two are nearer than SAME_PLACE."""
    squares: dict[tuple[int, int], list[Floats]] = {}  # kept places by squares of that side
    kept: list[Floats] = []
    for place in viewpoints:
        x, y = np.floor(place / SAME_PLACE).astype(int).tolist()
        around = [one for i in (x - 1, x, x + 1) for j in (y - 1, y, y + 1) for one in squares.get((i, j), ())]
        if not around or np.hypot(*(np.array(around) - place).T).min() >= SAME_PLACE:
            squares.setdefault((x, y), []).append(place)
            kept.append(place)
    return np.array(kept).reshape(-1, 2)

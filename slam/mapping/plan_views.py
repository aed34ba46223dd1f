"""Places in a plan from which rays are cast, and what the rays meet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.segments import Floats, Integers
from .plan import Plan

# Metres between places. Origin: chosen, half of the distance within which views show mostly the same surfaces.
VIEWPOINT_SPACING = 1.5
# Metres of free space around a place: a robot fits in, and the inside of a wall has none. Origin: chosen; not measured.
VIEWPOINT_CLEARANCE = 0.35
# Metres within which a place of the file is near enough to another one. Origin: definition, as the spacing.
SAME_PLACE = 0.5 * VIEWPOINT_SPACING
# Rays from a place. Origin: chosen, one per degree, as of a lidar.
RAYS = 360
# Metres that a ray reaches. Origin: chosen, farther walls are seen from nearer places.
RAY_REACH = 20.0
# Standard deviations of a plan's precision by which one side of a wall may seem to be behind the other.
# Origin: chosen, 99.7 %.
SAME_WALL_DEVIATIONS = 3.0
# Share of the rays from a place that must meet a visible side: otherwise it is outside of the building.
# Origin: definition, most of them.
MIN_MEETING = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Ray:
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


def find_viewpoints(plan: Plan) -> Floats:
    """Return places (k, 2) between the lines of a drawing, on a square grid, with VIEWPOINT_CLEARANCE around them."""
    points = plan.segments.reshape(-1, 2)
    low, high = points.min(axis=0), points.max(axis=0)
    axes = [np.arange(a + 0.5 * VIEWPOINT_SPACING, b, VIEWPOINT_SPACING) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    free = [_clearance(place, plan.segments) >= VIEWPOINT_CLEARANCE for place in grid]
    return np.asarray(grid[np.array(free, dtype=bool)].reshape(-1, 2))


def _clearance(place: Floats, segments: Floats) -> float:
    """Return the metres from a place to the nearest of segments (n, 2, 2)."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    share = np.clip(((place - start) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
    nearest = start + share[:, None] * along
    return float(np.hypot(*(nearest - place).T).min(initial=np.inf))


def cast_views(viewpoints: Floats, plan: Plan) -> list[Ray]:
    """Cast rays from places (k, 2) in a plan, and return those of places inside, in the order of a short tour."""
    rays = [_cast(place, plan) for place in _thinned(viewpoints)]
    return [ray for ray in _tour(rays) if _is_inside(ray, plan.segments, plan.one_sided)]


def _thinned(viewpoints: Floats) -> Floats:
    """Return places of which no two are nearer than SAME_PLACE."""
    kept: list[Floats] = []
    for place in viewpoints:
        if not kept or np.hypot(*(np.array(kept) - place).T).min() >= SAME_PLACE:
            kept.append(place)
    return np.array(kept).reshape(-1, 2)


def _tour(rays: Sequence[Ray]) -> list[Ray]:
    """Return rays in an order in which each place is the nearest one to that before, of those that are left."""
    if not rays:
        return []
    places, left, order = np.array([ray.position for ray in rays]), np.ones(len(rays), dtype=bool), [0]
    left[0] = False
    while left.any():
        distance = np.where(left, np.hypot(*(places - places[order[-1]]).T), np.inf)
        order.append(int(distance.argmin()))
        left[order[-1]] = False
    return [rays[k] for k in order]


def _is_inside(ray: Ray, segments: Floats, one_sided: np.ndarray) -> bool:
    """Return True if most rays from a place meet a piece, and from the side on which it can be seen."""
    met = ray.piece[ray.piece >= 0]
    start, along = segments[met, 0], segments[met, 1] - segments[met, 0]
    beam = ray.position - start
    visible = ~one_sided[met] | (along[:, 0] * beam[:, 1] - along[:, 1] * beam[:, 0] > 0.0)
    return bool(visible.sum() >= MIN_MEETING * RAYS)


def _cast(place: Floats, plan: Plan) -> Ray:
    """Cast rays from a place (2,).

    A ray p + t r meets the segment a + u (b - a) where t = (a - p) x (b - a) / r x (b - a) and
    u = (a - p) x r / r x (b - a), if t > 0 and 0 <= u <= 1.

    The two sides of a thin wall may be on one line, within the precision of the plan: a ray meets the one that faces
    the place.
    """
    segments, bearing = plan.segments, 2.0 * math.pi * (np.arange(RAYS) + 0.5) / RAYS
    near = np.flatnonzero(_reaches(place, segments))
    start, along = segments[near, 0] - place, segments[near, 1] - segments[near, 0]
    ray = np.column_stack([np.cos(bearing), np.sin(bearing)])
    across = ray[:, :1] * along[:, 1] - ray[:, 1:] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / across
        share = (start[:, 0] * ray[:, 1:] - start[:, 1] * ray[:, :1]) / across
    meets = (distance > 0.0) & (distance < RAY_REACH) & (share >= 0.0) & (share <= 1.0)
    distance = np.where(meets, distance, np.inf)
    if not len(near):
        return Ray(place, bearing, np.full(RAYS, np.inf), np.full(RAYS, -1))
    turned_away = plan.one_sided[near] & (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0] < 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        thickness = SAME_WALL_DEVIATIONS * plan.precision * np.hypot(*along.T) / np.abs(across)  # along the ray
    nearest = np.where(meets & turned_away, distance + thickness, distance).argmin(axis=1)
    shortest = distance[np.arange(RAYS), nearest]
    return Ray(place, bearing, shortest, np.where(np.isfinite(shortest), near[nearest], -1))


def _reaches(place: Floats, segments: Floats) -> np.ndarray:
    """Return (n,) which segments a ray of RAY_REACH may meet."""
    middle, half = segments.mean(axis=1), 0.5 * np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    return np.asarray(np.hypot(*(middle - place).T) - half < RAY_REACH)

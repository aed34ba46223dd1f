"""Prepare a scan for segmentation: usable rays in order, their weights, prefix sums, and certain breaks.

Rays are numbered 0..n-1 counter-clockwise from the start that `select_rays` chooses; n + k is ray k one revolution
later, so that a wall across the end of a full revolution is an interval like any other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .compiled import inlined, vectorised
from .normal_limits import GROSS_LIMIT
from .settings import Settings
from .types import Floats, Integers

# Radians of a full revolution. Origin: definition.
TURN = 2.0 * math.pi
# Radians. A larger gap between neighbouring usable rays is a break: nothing is known about what lies between them.
# Origin: chosen; not measured.
MAX_BEARING_GAP = 0.1
# Steps of the bearing grid that are no such gap if the lidar has only some dozens of beams: those between neighbours.
# Origin: definition.
NEIGHBOUR_STEPS = 1.5
# Range per metre of arc on a wall seen at 5 degrees from grazing; a steeper step of range is a break.
# Origin: geometry, 85 degrees of incidence.
GRAZING_SLOPE = math.tan(math.radians(85.0))
# Standard deviations of range by which a step of it must exceed that limit, so that there is no break by noise alone:
# GROSS_LIMIT, of the difference of two ranges. Origin: definition.
RANGE_STEP_SIGMAS = GROSS_LIMIT * math.sqrt(2.0)
# Steps of the bearing grid between two usable rays above which beams count as missing; one lost beam is allowed.
# Origin: definition.
MISSING_STEPS = 2.5
# Radians of bearing over which the slope of 1/range is computed: wide compared with bearing noise, narrow compared with
# a wall. Origin: chosen; not measured.
SLOPE_WINDOW = math.radians(2.4)
# Maximum number of rays in that window. Origin: chosen; not measured.
MAX_SLOPE_RAYS = 6
# Maximum slope of 1/range in bearing, relative to 1/range; steeper slopes are those of a step.
# Origin: geometry, tan 85 degrees.
MAX_SLOPE = 11.0


class Rays(NamedTuple):
    """Usable rays of one scan; the first n entries of the arrays are valid."""

    range: Floats
    inverse: Floats
    cos: Floats
    sin: Floats
    bearing: Floats  # radians, increasing, unwrapped
    beam: Integers  # index of the ray in the scan
    broken: Integers  # 1 if no wall can continue from ray k - 1 to ray k
    slope: Floats  # of 1/range in bearing before ray k, also for k a little beyond n (see find_slopes)
    prefix: Floats  # (6, n + 1) sums over rays before k of W, Re E, Im E, Re H, Im H, K (see wclm)


class RaySlice(NamedTuple):
    """Rays of one segment in contiguous arrays."""

    inverse: Floats
    cos: Floats
    sin: Floats


class Grid(NamedTuple):
    """Bearings of the last scan with their sines and cosines; the next scan usually has the same."""

    angle: Floats
    cos: Floats
    sin: Floats


# Rows of memory: of the grid; range, inverse, cos, sin and bearing; slope; prefix sums. Origin: definition.
FLOAT_ROWS = 3 + 5 + 1 + 6
# Beam and broken. Origin: definition.
INTEGER_ROWS = 2


def allocate(beams: int) -> tuple[Floats, Integers]:
    """Allocate memory for scans of up to `beams` beams, twice as long: see `rotate_rays`."""
    size = 2 * beams + MAX_SLOPE_RAYS
    return np.full((FLOAT_ROWS, size), np.nan), np.zeros((INTEGER_ROWS, size), dtype=np.int64)


@inlined
def views(floats: Floats, integers: Integers) -> tuple[Grid, Rays]:
    """Return the named parts of the memory from `allocate`."""
    grid = Grid(floats[0], floats[1], floats[2])
    rays = Rays(
        floats[3], floats[4], floats[5], floats[6], floats[7], integers[0], integers[1], floats[8], floats[9:15]
    )
    return grid, rays


@inlined
def wrap_index(k: int, count: int) -> int:
    """Return the index 0..n-1, n = `count`, of the ray k in 0..2n-1."""
    return k - count if k >= count else k


@inlined
def update_grid(angles: Floats, grid: Grid) -> None:
    """Update sine and cosine of the bearings that differ from those of the last scan."""
    for i in range(len(angles)):
        if angles[i] != grid.angle[i]:
            grid.angle[i] = angles[i]
            grid.cos[i] = math.cos(angles[i])
            grid.sin[i] = math.sin(angles[i])


@inlined
def widest_gap(step: float) -> float:
    """Return the widest gap of bearing between two rays of one surface, radians; `step` is that of the bearing grid."""
    return max(MAX_BEARING_GAP, NEIGHBOUR_STEPS * step)


@inlined
def select_rays(ranges: Floats, range_min: float, range_max: float, grid: Grid, buffer: Rays) -> tuple[Rays, int]:
    """Select the usable rays into `buffer`; return them from the start on, and their number.

    A beam is usable if its range is within the limits and its bearing above that of the previous usable beam; beams
    beyond one revolution are ignored. On a closed revolution the start is the farthest ray: the distance along a
    straight wall is convex, so the farthest visible point is a vertex of the outline and rarely lies within a wall, and
    it does not depend on where the revolution began.
    """
    count = farthest = 0
    most = 0.0
    last, limit = -math.inf, math.inf
    for beam in range(len(ranges)):
        distance, angle = ranges[beam], grid.angle[beam]
        if not (range_min <= distance <= range_max and last < angle < limit):
            continue
        if count == 0:
            limit = angle + TURN - 1e-9
        if distance > most:
            most, farthest = distance, count
        buffer.range[count], buffer.bearing[count], buffer.beam[count] = distance, angle, beam
        buffer.cos[count], buffer.sin[count] = grid.cos[beam], grid.sin[beam]
        last = angle
        count += 1
    if count == 0:
        return buffer, 0
    mean_step = (last - buffer.bearing[0]) / max(count - 1, 1)
    closed = buffer.bearing[0] + TURN - last < widest_gap(mean_step)
    return rotate_rays(farthest if closed else 0, count, buffer), count


@inlined
def rotate_rays(start: int, count: int, buffer: Rays) -> Rays:
    """Return the rays from ray `start` on; those before it are repeated after the last one, one revolution later."""
    repeat_first(buffer.range, start, count, 0.0)
    repeat_first(buffer.cos, start, count, 0.0)
    repeat_first(buffer.sin, start, count, 0.0)
    repeat_first(buffer.bearing, start, count, TURN)
    repeat_first(buffer.beam, start, count, 0)
    end = start + count
    invert_values(buffer.range[start:end], buffer.inverse)
    return Rays(
        buffer.range[start:end],
        buffer.inverse,
        buffer.cos[start:end],
        buffer.sin[start:end],
        buffer.bearing[start:end],
        buffer.beam[start:end],
        buffer.broken,
        buffer.slope,
        buffer.prefix,
    )


@vectorised
def repeat_first(values: Floats | Integers, start: int, count: int, difference: float) -> None:
    """Copy the first `start` of `count` values behind the last one, increased by `difference`."""
    source, target = values[:start], values[count : count + start]
    for k in range(start):
        target[k] = source[k] + difference


@vectorised
def invert_values(values: Floats, inverse: Floats) -> None:
    """Compute the inverse of every value."""
    for k in range(len(values)):
        inverse[k] = 1.0 / values[k]


@inlined
def bearing_step(angles: Floats, rays: Rays, count: int) -> float:
    """Return the mean step of bearing between beams, or between usable rays if the bearings do not increase."""
    step = (angles[-1] - angles[0]) / (len(angles) - 1)
    if not 0.0 < step < TURN:
        step = (rays.bearing[count - 1] - rays.bearing[0]) / (count - 1)
    return float(step)


@inlined
def mark_breaks(rays: Rays, count: int, step: float, settings: Settings) -> None:
    """Mark every ray that cannot continue the wall of the previous ray; ray 0 follows the last one.

    A break is a gap of bearing, a step of range that no wall up to 85 degrees of incidence explains, or missing beams
    across more than the widest gap in a wall. `step` is that of `bearing_step`.
    """
    widest = widest_gap(step)
    for k in range(count):
        before = k - 1 if k > 0 else count - 1
        gap = rays.bearing[k] - rays.bearing[before]
        if k == 0:
            gap += TURN
        near, far = min(rays.range[k], rays.range[before]), max(rays.range[k], rays.range[before])
        noise = settings.sigma_range + 2.0 * settings.sigma_bearing * near
        allowed = near * gap * GRAZING_SLOPE + RANGE_STEP_SIGMAS * noise
        broken = gap > widest or far - near > allowed
        if gap > MISSING_STEPS * step and distance_squared(rays, before, k) > settings.maximum_gap**2:
            broken = True
        rays.broken[k] = 1 if broken else 0


@inlined
def distance_squared(rays: Rays, first: int, second: int) -> float:
    """Return the squared distance between the end points of two rays, square metres."""
    dx = rays.range[first] * rays.cos[first] - rays.range[second] * rays.cos[second]
    dy = rays.range[first] * rays.sin[first] - rays.range[second] * rays.sin[second]
    return float(dx * dx + dy * dy)


@inlined
def slice_rays(rays: Rays, count: int, begin: int, end: int, buffer: RaySlice) -> RaySlice:
    """Return the rays begin..end-1, copied into `buffer` only if they extend beyond ray n."""
    if end <= count:
        return RaySlice(rays.inverse[begin:end], rays.cos[begin:end], rays.sin[begin:end])
    for k in range(begin, end):
        ray = wrap_index(k, count)
        buffer.inverse[k - begin] = rays.inverse[ray]
        buffer.cos[k - begin] = rays.cos[ray]
        buffer.sin[k - begin] = rays.sin[ray]
    return first_rays(buffer, end - begin)


@inlined
def first_rays(part: RaySlice, size: int) -> RaySlice:
    """Return the first `size` rays."""
    return RaySlice(part.inverse[:size], part.cos[:size], part.sin[:size])


@vectorised
def find_slopes(rays: Rays, count: int, reach: int) -> None:
    """Compute the absolute slope of 1/range in bearing from ray k - `reach` to ray k, k = 0..n+reach-1.

    It is infinite at both ends.
    """
    for k in range(reach):
        rays.slope[k] = rays.slope[count + k] = math.inf
    slope, inverse, inverse_before = rays.slope[reach:count], rays.inverse[reach:count], rays.inverse[: count - reach]
    bearing, bearing_before = rays.bearing[reach:count], rays.bearing[: count - reach]
    for k in range(len(slope)):
        slope[k] = abs((inverse[k] - inverse_before[k]) / (bearing[k] - bearing_before[k]))


@vectorised
def compute_weights(
    rays: Rays, count: int, reach: int, range_variance: float, bearing_variance: float, weights: Floats
) -> None:
    """Compute the inverse variance of 1/range of every ray.

    It depends on the slope of 1/range in bearing. No line is known yet, so the slope is computed from neighbouring
    rays: the smaller of forward and backward slope, as the other may lead around a corner.
    """
    inverse, backward, forward = rays.inverse[:count], rays.slope[:count], rays.slope[reach : count + reach]
    for k in range(len(inverse)):
        slope = min(MAX_SLOPE * inverse[k], backward[k], forward[k])
        square = inverse[k] * inverse[k]
        weights[k] = 1.0 / (range_variance * square * square + bearing_variance * slope * slope)


@vectorised
def accumulate_sums(rays: Rays, count: int, step: float, settings: Settings) -> None:
    """Compute the prefix sums of the weighted normal equations."""
    range_variance = settings.sigma_range**2 + settings.roughness**2
    bearing_variance = settings.sigma_bearing**2
    reach = 2
    while reach < MAX_SLOPE_RAYS and reach * step < SLOPE_WINDOW:
        reach += 1
    reach = min(reach, count - 1)
    find_slopes(rays, count, reach)
    weights = rays.prefix[0, 1:]  # overwritten by their sums below
    compute_weights(rays, count, reach, range_variance, bearing_variance, weights)
    weight = er = ei = hr = hi = total = 0.0
    prefix = rays.prefix
    prefix[:, 0] = 0.0
    for k in range(count):
        w, eta, c, s = weights[k], rays.inverse[k], rays.cos[k], rays.sin[k]
        eta *= 1.0 - range_variance * eta * eta
        weight += w
        er += w * (c * c - s * s)
        ei += 2.0 * w * c * s
        hr += w * eta * c
        hi += w * eta * s
        total += w * eta * eta
        prefix[0, k + 1] = weight
        prefix[1, k + 1] = er
        prefix[2, k + 1] = ei
        prefix[3, k + 1] = hr
        prefix[4, k + 1] = hi
        prefix[5, k + 1] = total

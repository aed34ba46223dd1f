"""A scan made ready for segmentation: usable rays in order, their weights, prefix sums, and certain breaks.

Rays are numbered 0..n-1 counter-clockwise from the start that `select` chose; n + k means ray k one revolution later,
so that a wall across the end of a full revolution is one interval like any other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .compiled import compiled, vectorised
from .settings import Settings
from .types import Floats, Integers

TURN = 2.0 * math.pi

MAX_BEARING_GAP = 0.1
"""Radians between neighbouring usable rays beyond which nothing is known about what lies between them: a break."""

GRAZING_SLOPE = math.tan(math.radians(85.0))
"""Range per metre of arc on a wall seen 5 degrees off grazing; a steeper step of range is a break, not a wall."""

JUMP_SIGMAS = 5.0 * math.sqrt(2.0)
"""Noise of a difference of two ranges, at five standard deviations, which a step must exceed besides."""

MISSING_STEPS = 2.5
"""Steps of the bearing grid between two usable rays beyond which beams count as missing; one lost beam may be."""

SLOPE_WINDOW = math.radians(2.4)
"""Span of bearing over which the slope of 1/range is taken: wide against bearing noise, narrow against a wall."""

MAX_SLOPE_RAYS = 6
"""Most rays that the window of the slope reaches."""

MAX_SLOPE = 11.0
"""Largest slope of 1/range in bearing in units of 1/range: tan 85 degrees; beyond it the slope is a jump's."""


class Rays(NamedTuple):
    """The usable rays of one scan. Of the arrays, the first n entries are valid."""

    range: Floats
    inverse: Floats
    cos: Floats
    sin: Floats
    bearing: Floats  # radians, increasing, unwrapped
    beam: Integers  # index of the ray in the scan
    broken: Integers  # 1 where no wall can continue from ray k - 1 to ray k
    slope: Floats  # of 1/range in bearing before ray k, also for k a little beyond n (see find_slopes)
    prefix: Floats  # (6, n + 1) sums over rays before k of W, Re E, Im E, Re H, Im H, K (see wclm)


class Part(NamedTuple):
    """The rays of one piece side by side."""

    inverse: Floats
    cos: Floats
    sin: Floats


class Grid(NamedTuple):
    """Bearings of the last scan with their sines and cosines; the next scan mostly has the same."""

    angle: Floats
    cos: Floats
    sin: Floats


FLOAT_ROWS = 3 + 5 + 1 + 6
INTEGER_ROWS = 2


def allocate(beams: int) -> tuple[Floats, Integers]:
    """Memory for scans of up to `beams` beams, twice as long: see `start_at`."""
    size = 2 * beams + MAX_SLOPE_RAYS
    return np.full((FLOAT_ROWS, size), np.nan), np.zeros((INTEGER_ROWS, size), dtype=np.int64)


@compiled
def views(floats: Floats, integers: Integers) -> tuple[Grid, Rays]:
    """The named parts of the memory that `allocate` gave."""
    grid = Grid(floats[0], floats[1], floats[2])
    rays = Rays(
        floats[3], floats[4], floats[5], floats[6], floats[7], integers[0], integers[1], floats[8], floats[9:15]
    )
    return grid, rays


@compiled
def wrap(k: int, count: int) -> int:
    """The ray among 0..n-1, n = `count`, that k in 0..2n-1 stands for."""
    return k - count if k >= count else k


@compiled
def update_grid(angles: Floats, grid: Grid) -> None:
    """Sine and cosine of every bearing, computed only where the bearing differs from the last scan's."""
    for i in range(len(angles)):
        if angles[i] != grid.angle[i]:
            grid.angle[i] = angles[i]
            grid.cos[i] = math.cos(angles[i])
            grid.sin[i] = math.sin(angles[i])


@compiled
def select(ranges: Floats, range_min: float, range_max: float, grid: Grid, space: Rays) -> tuple[Rays, int]:
    """The usable rays, from the start on, in the memory of `space`, and their number.

    A beam is usable if its range is within the limits and its bearing above that of the usable beam before; what
    exceeds one revolution is left out. On a closed revolution the start is the farthest ray. The farthest visible
    point is a vertex of what is seen, since the distance along a straight wall is convex, so that the start rarely
    falls within a wall; and it does not depend on where the revolution began.
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
        space.range[count], space.bearing[count], space.beam[count] = distance, angle, beam
        space.cos[count], space.sin[count] = grid.cos[beam], grid.sin[beam]
        last = angle
        count += 1
    if count == 0:
        return space, 0
    closed = space.bearing[0] + TURN - last < MAX_BEARING_GAP
    return start_at(farthest if closed else 0, count, space), count


@compiled
def start_at(start: int, count: int, space: Rays) -> Rays:
    """The rays from ray `start` on; those before it are repeated after the last one, a revolution later."""
    repeat(space.range, start, count, 0.0)
    repeat(space.cos, start, count, 0.0)
    repeat(space.sin, start, count, 0.0)
    repeat(space.bearing, start, count, TURN)
    repeat(space.beam, start, count, 0)
    end = start + count
    invert(space.range[start:end], space.inverse)
    return Rays(
        space.range[start:end],
        space.inverse,
        space.cos[start:end],
        space.sin[start:end],
        space.bearing[start:end],
        space.beam[start:end],
        space.broken,
        space.slope,
        space.prefix,
    )


@vectorised
def repeat(values: Floats | Integers, start: int, count: int, difference: float) -> None:
    """Write the first `start` of `count` values after the last one, larger by `difference`."""
    source, target = values[:start], values[count : count + start]
    for k in range(start):
        target[k] = source[k] + difference


@vectorised
def invert(values: Floats, inverse: Floats) -> None:
    """1/x of every value x."""
    for k in range(len(values)):
        inverse[k] = 1.0 / values[k]


@compiled
def spacing(angles: Floats, rays: Rays, count: int) -> float:
    """Mean step of bearing from beam to beam; among usable rays only, where the scan's own bearings are unfit."""
    step = (angles[-1] - angles[0]) / (len(angles) - 1)
    if not 0.0 < step < TURN:
        step = (rays.bearing[count - 1] - rays.bearing[0]) / (count - 1)
    return float(step)


@compiled
def mark_breaks(rays: Rays, count: int, step: float, settings: Settings) -> None:
    """Flag every ray that cannot continue the wall of the ray before it; ray 0 comes after the last one.

    `step` is the grid's spacing of bearings. A break is a gap of bearing, a step of range that no wall up to 85
    degrees of incidence explains, or missing beams over more than the widest gap in a wall.
    """
    for k in range(count):
        before = k - 1 if k > 0 else count - 1
        gap = rays.bearing[k] - rays.bearing[before]
        if k == 0:
            gap += TURN
        near, far = min(rays.range[k], rays.range[before]), max(rays.range[k], rays.range[before])
        noise = settings.sigma_range + 2.0 * settings.sigma_bearing * near
        allowed = near * gap * GRAZING_SLOPE + JUMP_SIGMAS * noise
        broken = gap > MAX_BEARING_GAP or far - near > allowed
        if gap > MISSING_STEPS * step and distance_squared(rays, before, k) > settings.maximum_gap**2:
            broken = True
        rays.broken[k] = 1 if broken else 0


@compiled
def distance_squared(rays: Rays, first: int, second: int) -> float:
    """Square of the distance between the end points of two rays, metres^2."""
    dx = rays.range[first] * rays.cos[first] - rays.range[second] * rays.cos[second]
    dy = rays.range[first] * rays.sin[first] - rays.range[second] * rays.sin[second]
    return float(dx * dx + dy * dy)


@compiled
def part_of(rays: Rays, count: int, begin: int, end: int, room: Part) -> Part:
    """Rays begin..end-1: where they are, or copied into `room` where they run over ray n."""
    if end <= count:
        return Part(rays.inverse[begin:end], rays.cos[begin:end], rays.sin[begin:end])
    for k in range(begin, end):
        ray = wrap(k, count)
        room.inverse[k - begin] = rays.inverse[ray]
        room.cos[k - begin] = rays.cos[ray]
        room.sin[k - begin] = rays.sin[ray]
    return head_of(room, end - begin)


@compiled
def head_of(part: Part, size: int) -> Part:
    """The first `size` rays."""
    return Part(part.inverse[:size], part.cos[:size], part.sin[:size])


@vectorised
def find_slopes(rays: Rays, count: int, reach: int) -> None:
    """Absolute slope of 1/range in bearing from ray k - `reach` to ray k, at k = 0..n+reach-1; infinite at the ends."""
    for k in range(reach):
        rays.slope[k] = rays.slope[count + k] = math.inf
    slope, inverse, inverse_before = rays.slope[reach:count], rays.inverse[reach:count], rays.inverse[: count - reach]
    bearing, bearing_before = rays.bearing[reach:count], rays.bearing[: count - reach]
    for k in range(len(slope)):
        slope[k] = abs((inverse[k] - inverse_before[k]) / (bearing[k] - bearing_before[k]))


@vectorised
def weigh(rays: Rays, count: int, reach: int, range_variance: float, bearing_variance: float, weights: Floats) -> None:
    """Inverse variance of 1/range of every ray.

    It needs the slope of 1/range in bearing. No line is known yet, so that is taken from the rays around: the smaller
    one of forward and backward slope, as the other may lead around a corner.
    """
    inverse, backward, forward = rays.inverse[:count], rays.slope[:count], rays.slope[reach : count + reach]
    for k in range(len(inverse)):
        slope = min(MAX_SLOPE * inverse[k], backward[k], forward[k])
        square = inverse[k] * inverse[k]
        weights[k] = 1.0 / (range_variance * square * square + bearing_variance * slope * slope)


@vectorised
def accumulate(rays: Rays, count: int, step: float, settings: Settings) -> None:
    """Prefix sums of the weighted normal equations."""
    range_variance = settings.sigma_range**2 + settings.roughness**2
    bearing_variance = settings.sigma_bearing**2
    reach = 2
    while reach < MAX_SLOPE_RAYS and reach * step < SLOPE_WINDOW:
        reach += 1
    reach = min(reach, count - 1)
    find_slopes(rays, count, reach)
    weights = rays.prefix[0, 1:]  # where their sums will be
    weigh(rays, count, reach, range_variance, bearing_variance, weights)
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

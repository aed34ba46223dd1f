"""Whether two neighbouring lines are the chords of one curved surface, which has no corner between them.

About the point where the chords meet, with the x axis along both on average, a curved surface is y = a + b x + c x^2 as
far as two chords reach: a circle departs from its parabola by a thousandth of its radius over 60 degrees.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .compiled import compiled
from .rays import Rays, wrap
from .settings import Settings
from .types import Flags, Floats, Integers
from .wclm import GATE

BULGE = 4.0 / 45.0
"""Mean square distance of an arc from its chord's best line, in units of the squared height of the arc."""

UNSPLIT = 1.5
"""Chi-square in units of the penalty by which an arc would have been divided further, noise or not."""

BESIDE_A_CHORD = 8.0
"""Chi-square by which one curve may be the worse explanation where another pair of lines has shown that it is one."""


class Frame(NamedTuple):
    """Where the two chords meet, and the unit vector along both on average; `rise` is the second one's slope there."""

    x: float
    y: float
    cos: float
    sin: float
    rise: float


@compiled
def frame_of(first: Floats, second: Floats) -> Frame:
    """The frame between the end of the line `first` and the start of the line `second`."""
    ax, ay = first[8] - first[6], first[9] - first[7]
    bx, by = second[8] - second[6], second[9] - second[7]
    a, b = math.hypot(ax, ay), math.hypot(bx, by)
    tx, ty = ax / a + bx / b, ay / a + by / b
    size = math.hypot(tx, ty)
    rise = (bx * -ty + by * tx) / (bx * tx + by * ty)
    return Frame(0.5 * (first[8] + second[6]), 0.5 * (first[9] + second[7]), tx / size, ty / size, rise)


@compiled
def local(
    distance: float, cos: float, sin: float, frame: Frame, rise: float, settings: Settings
) -> tuple[float, float, float]:
    """x and y of a ray's end in the frame, and the variance of its y above a surface that rises by `rise` per x."""
    ex = cos * frame.cos + sin * frame.sin
    ey = sin * frame.cos - cos * frame.sin
    x = distance * ex - frame.x * frame.cos - frame.y * frame.sin
    y = distance * ey + frame.x * frame.sin - frame.y * frame.cos
    along, across = ey - rise * ex, distance * (ex + rise * ey)
    range_variance = settings.sigma_range**2 + settings.roughness**2
    return x, y, range_variance * along * along + (settings.sigma_bearing * across) ** 2


@compiled
def fit_parabola(
    rays: Rays, count: int, begin: int, middle: int, end: int, frame: Frame, settings: Settings
) -> tuple[float, float, float]:
    """(a, b, c) of y = a + b x + c x^2 through the rays begin..end-1, from `middle` on the second chord's."""
    s0 = s1 = s2 = s3 = s4 = p = q = r = 0.0
    distances, cosines, sines = rays.range, rays.cos, rays.sin
    for i in range(begin, end):
        ray = wrap(i, count)
        rise = -frame.rise if i < middle else frame.rise
        x, y, variance = local(distances[ray], cosines[ray], sines[ray], frame, rise, settings)
        w = 1.0 / variance
        wx = w * x
        wxx = wx * x
        s0, s1, s2, s3, s4 = s0 + w, s1 + wx, s2 + wxx, s3 + wxx * x, s4 + wxx * x * x
        p, q, r = p + w * y, q + wx * y, r + wxx * y
    first, second, third = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
    determinant = s0 * first + s1 * second + s2 * third
    cross = s1 * s2 - s0 * s3
    return (
        (first * p + second * q + third * r) / determinant,
        (second * p + (s0 * s4 - s2 * s2) * q + cross * r) / determinant,
        (third * p + cross * q + (s0 * s2 - s1 * s1) * r) / determinant,
    )


@compiled
def excess(
    rays: Rays,
    count: int,
    begin: int,
    end: int,
    line: Floats,
    rise: float,
    frame: Frame,
    curve: tuple[float, float, float],
    settings: Settings,
) -> float:
    """Chi-square of rays begin..end-1 about the curve less that about their line; each ray's at most the gate."""
    total = 0.0
    u, v = line[0], line[1]
    steepness = math.sqrt((1.0 + rise * rise) / (u * u + v * v))
    distances, cosines, sines = rays.range, rays.cos, rays.sin
    for i in range(begin, end):
        ray = wrap(i, count)
        distance, cos, sin = distances[ray], cosines[ray], sines[ray]
        x, y, variance = local(distance, cos, sin, frame, rise, settings)
        above = y - curve[0] - x * (curve[1] + x * curve[2])
        beside = steepness * (1.0 - distance * (u * cos + v * sin))
        total += min(above * above / variance, GATE) - min(beside * beside / variance, GATE)
    return total


@compiled
def bulge(line: Floats, count: int, curvature: float, settings: Settings) -> float:
    """Chi-square by which an arc of that curvature would depart from this chord of it."""
    dx, dy = line[8] - line[6], line[9] - line[7]
    height = (dx * dx + dy * dy) * curvature / 8.0
    return float(count * BULGE * height * height / (settings.sigma_range**2 + settings.roughness**2))


@compiled
def evidence(
    rays: Rays,
    count: int,
    first: Floats,
    second: Floats,
    begin: int,
    end: int,
    start: int,
    stop: int,
    settings: Settings,
) -> float:
    """Chi-square by which one curve explains two lines' rays worse than the lines do; infinity where that is plain.

    Line `first` has the rays begin..end-1 and `second` start..stop-1, which may count on over the end of a revolution.
    Lines are rows as `condense.Found` has them.
    """
    frame = frame_of(first, second)
    lengths = math.hypot(first[8] - first[6], first[9] - first[7])
    lengths += math.hypot(second[8] - second[6], second[9] - second[7])
    # an arc turns from the middle of one chord to the middle of the other by the angle between the two
    curvature = 4.0 * math.atan(abs(frame.rise)) / lengths
    undivided = UNSPLIT * settings.penalty
    if not (bulge(first, end - begin, curvature, settings) < undivided):
        return math.inf
    if not (bulge(second, stop - start, curvature, settings) < undivided):
        return math.inf
    curve = fit_parabola(rays, count, begin, start, stop, frame, settings)
    worse = excess(rays, count, begin, end, first, -frame.rise, frame, curve, settings)
    worse += excess(rays, count, start, stop, second, frame.rise, frame, curve, settings)
    return worse if math.isfinite(worse) else math.inf


@compiled
def leave_out(corners: Floats, pairs: Integers, curved: Flags, made: int) -> int:
    """Leave out the corners that are none, and mark the lines in `curved` that are chords; the number of corners left.

    The last column of `corners` is the evidence for each, as above. A line known to be a chord needs less of it that
    the next one is too: curves seldom come in pairs of chords.
    """
    marked = True
    while marked:
        marked = False
        for k in range(made):
            before, after = pairs[k, 0], pairs[k, 1]
            if curved[before] and curved[after]:
                continue
            if corners[k, -1] < (BESIDE_A_CHORD if curved[before] or curved[after] else 0.0):
                curved[before] = curved[after] = True
                marked = True
    kept = 0
    for k in range(made):
        before, after = pairs[k, 0], pairs[k, 1]
        if corners[k, -1] < (BESIDE_A_CHORD if curved[before] or curved[after] else 0.0):
            continue
        for column in range(corners.shape[1]):
            corners[kept, column] = corners[k, column]
        pairs[kept, 0], pairs[kept, 1] = before, after
        kept += 1
    return kept

"""Test if two neighbouring lines are chords of one curved surface, which has no corner between them.

In a frame at the point where the chords meet, with x along their mean direction, a curved surface is approximately
y = a + b x + c x^2 over two chords: a circle deviates from its parabola by a thousandth of its radius over 60 degrees.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .compiled import inlined
from .rays import Rays, wrap_index
from .settings import Settings
from .types import Flags, Floats, Integers
from .wclm import INLIER_GATE

# Mean square distance of an arc from its best line, relative to the squared height of the arc. Origin: geometry.
ARC_MEAN_SQUARE = 4.0 / 45.0

# Chi-square, in units of the penalty, above which an arc would have been split further despite noise.
# Origin: chosen; not measured.
UNDIVIDED_FACTOR = 1.5

# Evidence against a curve that a corner needs if one of its lines is known to be a chord.
# Origin: chosen; not measured.
MIN_EVIDENCE_AT_CHORD = 8.0


class Frame(NamedTuple):
    """Point where two chords meet, and unit vector of their mean direction; `rise` is the slope of the second one."""

    x: float
    y: float
    cos: float
    sin: float
    rise: float


@inlined
def chord_frame(first: Floats, second: Floats) -> Frame:
    """Return the frame between the end of the line `first` and the start of the line `second`."""
    ax, ay = first[8] - first[6], first[9] - first[7]
    bx, by = second[8] - second[6], second[9] - second[7]
    a, b = math.hypot(ax, ay), math.hypot(bx, by)
    tx, ty = ax / a + bx / b, ay / a + by / b
    size = math.hypot(tx, ty)
    rise = (bx * -ty + by * tx) / (bx * tx + by * ty)
    return Frame(0.5 * (first[8] + second[6]), 0.5 * (first[9] + second[7]), tx / size, ty / size, rise)


@inlined
def to_frame(
    distance: float, cos: float, sin: float, frame: Frame, rise: float, settings: Settings
) -> tuple[float, float, float]:
    """Return x, y of a ray's end in the frame, and the variance of its distance in y from a surface of slope `rise`."""
    ex = cos * frame.cos + sin * frame.sin
    ey = sin * frame.cos - cos * frame.sin
    x = distance * ex - frame.x * frame.cos - frame.y * frame.sin
    y = distance * ey + frame.x * frame.sin - frame.y * frame.cos
    along, across = ey - rise * ex, distance * (ex + rise * ey)
    range_variance = settings.sigma_range**2 + settings.roughness**2
    return x, y, range_variance * along * along + (settings.sigma_bearing * across) ** 2


@inlined
def fit_parabola(
    rays: Rays, count: int, begin: int, middle: int, end: int, frame: Frame, settings: Settings
) -> tuple[float, float, float, float]:
    """Return (a, b, c) of y = a + b x + c x^2 through the rays begin..end-1; the second chord begins at `middle`.

    The fourth value is the variance of c.
    """
    s0 = s1 = s2 = s3 = s4 = p = q = r = 0.0
    distances, cosines, sines = rays.range, rays.cos, rays.sin
    for i in range(begin, end):
        ray = wrap_index(i, count)
        rise = -frame.rise if i < middle else frame.rise
        x, y, variance = to_frame(distances[ray], cosines[ray], sines[ray], frame, rise, settings)
        w = 1.0 / variance
        wx = w * x
        wxx = wx * x
        s0, s1, s2, s3, s4 = s0 + w, s1 + wx, s2 + wxx, s3 + wxx * x, s4 + wxx * x * x
        p, q, r = p + w * y, q + wx * y, r + wxx * y
    first, second, third = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
    determinant = s0 * first + s1 * second + s2 * third
    cross, least = s1 * s2 - s0 * s3, s0 * s2 - s1 * s1
    return (
        (first * p + second * q + third * r) / determinant,
        (second * p + (s0 * s4 - s2 * s2) * q + cross * r) / determinant,
        (third * p + cross * q + least * r) / determinant,
        least / determinant,
    )


@inlined
def chi2_difference(
    rays: Rays,
    count: int,
    begin: int,
    end: int,
    line: Floats,
    rise: float,
    frame: Frame,
    curve: tuple[float, float, float, float],
    settings: Settings,
) -> float:
    """Return the chi-square of rays begin..end-1 about the curve minus that about their line, limited by the gate."""
    total = 0.0
    u, v = line[0], line[1]
    steepness = math.sqrt((1.0 + rise * rise) / (u * u + v * v))
    distances, cosines, sines = rays.range, rays.cos, rays.sin
    for i in range(begin, end):
        ray = wrap_index(i, count)
        distance, cos, sin = distances[ray], cosines[ray], sines[ray]
        x, y, variance = to_frame(distance, cos, sin, frame, rise, settings)
        above = y - curve[0] - x * (curve[1] + x * curve[2])
        beside = steepness * (1.0 - distance * (u * cos + v * sin))
        total += min(above * above / variance, INLIER_GATE) - min(beside * beside / variance, INLIER_GATE)
    return total


@inlined
def arc_chi2(line: Floats, count: int, curvature: float, settings: Settings) -> float:
    """Return the expected chi-square of an arc of the given curvature about this chord of it."""
    dx, dy = line[8] - line[6], line[9] - line[7]
    height = (dx * dx + dy * dy) * curvature / 8.0
    return float(count * ARC_MEAN_SQUARE * height * height / (settings.sigma_range**2 + settings.roughness**2))


@inlined
def curve_evidence(
    rays: Rays,
    count: int,
    first: Floats,
    second: Floats,
    begin: int,
    end: int,
    start: int,
    stop: int,
    least_bend: float,
    settings: Settings,
) -> float:
    """Return the evidence against a curve: chi-square of two lines' rays about one curve minus that about the lines.

    It is infinite if the curve is ruled out: an arc of this size would have been split further, the curve deviates from
    a straight line by less than `least_bend` (metres, root mean square), or it decreases the chi-square of that line by
    less than the penalty. Line `first` has the rays begin..end-1 and `second` start..stop-1, which may extend beyond
    the end of a revolution. Lines are rows of `FeatureBuffers.lines`.
    """
    frame = chord_frame(first, second)
    lengths = math.hypot(first[8] - first[6], first[9] - first[7])
    lengths += math.hypot(second[8] - second[6], second[9] - second[7])
    # an arc turns by the angle between the chords from the middle of one to the middle of the other
    curvature = 4.0 * math.atan(abs(frame.rise)) / lengths
    if math.sqrt(ARC_MEAN_SQUARE) * lengths * lengths * curvature / 8.0 < least_bend:
        return math.inf
    undivided = UNDIVIDED_FACTOR * settings.penalty
    if not (arc_chi2(first, end - begin, curvature, settings) < undivided):
        return math.inf
    if not (arc_chi2(second, stop - start, curvature, settings) < undivided):
        return math.inf
    curve = fit_parabola(rays, count, begin, start, stop, frame, settings)
    if not (curve[2] ** 2 > settings.penalty * curve[3]):
        return math.inf
    evidence = chi2_difference(rays, count, begin, end, first, -frame.rise, frame, curve, settings)
    evidence += chi2_difference(rays, count, start, stop, second, frame.rise, frame, curve, settings)
    return evidence if math.isfinite(evidence) else math.inf


@inlined
def remove_curve_corners(corners: Floats, pairs: Integers, curved: Flags, count: int) -> int:
    """Mark the lines that are chords in `curved`, keep the corners that are on no curve, and return how many.

    corners, pairs  as in `FeatureBuffers`, `count` rows

    Next to a known chord lines need more evidence against a curve, because curves rarely consist of only two chords.
    """
    marked = True
    while marked:
        marked = False
        for k in range(count):
            before, after = pairs[k, 0], pairs[k, 1]
            if curved[before] and curved[after]:
                continue
            if corners[k, -1] < (MIN_EVIDENCE_AT_CHORD if curved[before] or curved[after] else 0.0):
                curved[before] = curved[after] = True
                marked = True
    kept = 0
    for k in range(count):
        before, after = pairs[k, 0], pairs[k, 1]
        evidence = corners[k, -1] - (MIN_EVIDENCE_AT_CHORD if curved[before] or curved[after] else 0.0)
        if evidence < 0.0 or math.isnan(corners[k, 0]):
            continue
        for column in range(corners.shape[1]):
            corners[kept, column] = corners[k, column]
        pairs[kept, 0], pairs[kept, 1] = before, after
        kept += 1
    return kept

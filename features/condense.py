"""One scan condensed into lines and corners: the one compiled call behind Extractor."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from .compiled import compiled, vectorised
from .corner import intersect, parallel
from .curves import evidence, leave_out
from .estimators import MAXIMUM_LIKELIHOOD, fit_by_code
from .merging import drop_small
from .pieces import Pieces, line
from .pieces import views as piece_views
from .rays import (
    MAX_BEARING_GAP,
    TURN,
    Part,
    Rays,
    accumulate,
    head_of,
    mark_breaks,
    part_of,
    select,
    spacing,
    update_grid,
    wrap,
)
from .rays import views as ray_views
from .segmentation import segment
from .settings import Settings
from .sums import at, bearing_variance
from .tracking import track
from .types import Flags, Floats, Integers
from .wclm import GATE, ITERATIONS, reweighted

CLOSEST = 5.0
"""Least range of a usable ray in units of the range noise; closer, 1/range is far from Gaussian."""

MIN_BEARING_VARIANCE = 10.0
"""Least variance of a line's bearings in units of the bearing noise; below, noise alone spreads the rays."""

MIN_INLIERS = 0.6
"""Least share of a piece's rays that its line must explain; bridged rays are few."""

MAX_CHI2 = 4.0
"""Largest chi-square per degree of freedom of a line: residuals of twice the noise. Clutter fits worse than walls."""

CORNER_STEPS = 1.5
CORNER_SIGMAS = 3.0
"""Steps, and standard deviations, of bearing by which a corner may miss the rays next to it."""

CORNER_RANGE = 1.3
CORNER_RANGE_SIGMAS = 6.0
"""Largest range of a corner: times the range of the farther ray next to it, plus standard deviations of range."""

CORNER_RAYS = 8
"""Most rays between the walls of a corner."""

CORNER_DEVIATION = 0.3
"""Largest standard deviation of a corner's position, metres; beyond it, it is no point to know a place by."""

END_RAYS = 1
"""Rays at either end of a piece that its line is not fitted to: they may lie half beside the wall, or on the jamb
around its edge, and always pull to the same side, so that no number of scans averages it out."""

ADAPT_RAYS = 15
"""Least rays of a line that tells something about the range noise."""


class Found(NamedTuple):
    """Features as the compiled call writes them, a row each.

    lines     u, v, Cuu, Cuv, Cuv, Cvv, start x, y, end x, y, chi2, variance of the end's bearing
    spans     first beam, last beam, rays used, first ray, last ray (see rays)
    curved    whether a line is a chord of a curved surface
    corners   x, y, Cxx, Cxy, Cxy, Cyy, evidence that it is one (see curves)
    pairs     line before, line after
    evidence  range variances that long pieces show, sorted
    """

    lines: Floats
    spans: Integers
    curved: Flags
    corners: Floats
    pairs: Integers
    evidence: Floats


@compiled
def within_gate(inverse: float, cos: float, sin: float, u: float, v: float, settings: Settings) -> bool:
    """Whether a ray is within the gate of the line; true for a line of NaN."""
    p, t = u * cos + v * sin, v * cos - u * sin
    residual = inverse - p
    variance = (settings.sigma_range * p * p) ** 2 + (settings.sigma_bearing * t) ** 2
    return not residual * residual > GATE * variance


@compiled
def lies_on(rays: Rays, ray: int, u: float, v: float, settings: Settings) -> bool:
    """Whether ray number `ray` is within the gate of the line."""
    return within_gate(rays.inverse[ray], rays.cos[ray], rays.sin[ray], u, v, settings)


@vectorised
def shown_variance(part: Part, u: float, v: float, sigma_range: float, sigma_bearing: float) -> float:
    """Range variance that the residuals of a line show: one scoring step on the likelihood of that variance.

    A residual r has variance s p^4 + q with s the range variance and q = sigma_bearing^2 t^2 known. Its likelihood is
    stationary in s at sum w^2 p^4 (r^2 - q) / sum w^2 p^8; two of n degrees of freedom went into the line.
    """
    range_variance, bearing_variance = sigma_range * sigma_range, sigma_bearing * sigma_bearing
    above = below = used = 0.0
    for i in range(len(part.inverse)):
        p, t = u * part.cos[i] + v * part.sin[i], v * part.cos[i] - u * part.sin[i]
        residual = part.inverse[i] * (1.0 - range_variance * part.inverse[i] * part.inverse[i]) - p
        quartic, known = p * p * p * p, bearing_variance * t * t
        w = 1.0 / (range_variance * quartic + known)
        inlier = 1.0 if w * residual * residual <= GATE else 0.0
        wq = inlier * w * w * quartic
        above += wq * (residual * residual - known)
        below += wq * quartic
        used += inlier
    return above / below * used / max(1.0, used - 2.0) if below > 0.0 else math.nan


@compiled
def inliers(part: Part, u: float, v: float, settings: Settings, room: Part) -> Part:
    """The rays within the gate of the line, copied into `room`."""
    kept = 0
    for i in range(len(part.inverse)):
        if within_gate(part.inverse[i], part.cos[i], part.sin[i], u, v, settings):
            room.inverse[kept], room.cos[kept], room.sin[kept] = part.inverse[i], part.cos[i], part.sin[i]
            kept += 1
    return head_of(room, kept)


@compiled
def fit_piece(
    rays: Rays, count: int, pieces: Pieces, piece: int, room: Part, settings: Settings, found: Found, lines: int
) -> tuple[bool, float]:
    """Fit a piece and write it as line `lines` unless it is none; the range variance it shows, or NaN."""
    begin, end = pieces.begin[piece], pieces.end[piece]
    if end - begin < settings.minimum_count:
        return False, math.nan
    spare = min(END_RAYS, (end - begin - settings.minimum_count) // 2)
    part = part_of(rays, count, begin + spare, end - spare, room)
    u, v = line(pieces, piece)
    cuu = cuv = cvv = chi2 = math.nan
    used = 0
    for _ in range(ITERATIONS):
        u, v, cuu, cuv, cvv, chi2, used = reweighted(
            part.inverse, part.cos, part.sin, u, v, settings.sigma_range, settings.sigma_bearing, GATE
        )
        if used < settings.minimum_count or used < MIN_INLIERS * len(part.inverse):
            return False, math.nan
    variance = math.nan
    if used >= ADAPT_RAYS:
        variance = shown_variance(part, u, v, settings.sigma_range, settings.sigma_bearing)
    spread = bearing_variance(at(pieces.sums, piece))
    if not (chi2 <= MAX_CHI2 * (used - 2) and spread >= MIN_BEARING_VARIANCE * settings.sigma_bearing**2):
        return False, variance
    while begin < end - 1 and not lies_on(rays, wrap(begin, count), u, v, settings):
        begin += 1
    while begin < end - 1 and not lies_on(rays, wrap(end - 1, count), u, v, settings):
        end -= 1
    if settings.estimator != MAXIMUM_LIKELIHOOD:
        part = inliers(part, u, v, settings, room)
        u, v, cuu, cuv, cvv = fit_by_code(
            settings.estimator, part.inverse, part.cos, part.sin, settings.sigma_range, settings.sigma_bearing
        )
    cuu += pieces.spread[0, piece]
    cuv += pieces.spread[1, piece]
    cvv += pieces.spread[2, piece]
    row = found.lines[lines]
    row[0], row[1], row[2], row[3], row[4], row[5], row[10] = u, v, cuu, cuv, cuv, cvv, chi2
    row[11] = pieces.spread[3, piece]
    first, last = wrap(begin, count), wrap(end - 1, count)
    for ray, column in ((first, 6), (last, 8)):
        distance = 1.0 / (u * rays.cos[ray] + v * rays.sin[ray])
        row[column], row[column + 1] = distance * rays.cos[ray], distance * rays.sin[ray]
    span = found.spans[lines]
    span[0], span[1], span[2], span[3], span[4] = rays.beam[first], rays.beam[last], used, begin, end - 1
    found.curved[lines] = False
    return math.hypot(row[8] - row[6], row[9] - row[7]) >= settings.minimum_length, variance


@compiled
def find_corner(
    rays: Rays, count: int, step: float, found: Found, before: int, after: int, settings: Settings, corners: int
) -> bool:
    """Write the corner of line `before` with the next line `after` as corner `corners`; False where there is none.

    The corner must appear between the last ray of the one and the first ray of the other line, and no farther than
    they: a test in bearing, where occlusion happens, accepts more corners than one on distances of end points.
    """
    first, second = found.lines[before], found.lines[after]
    if parallel(first[0], first[1], second[0], second[1]):
        return False
    last, following = wrap(found.spans[before, 4], count), wrap(found.spans[after, 3], count)
    between = following - last - 1
    if between < 0:
        between += count
    if between > CORNER_RAYS:
        return False
    x, y, cxx, cxy, cyy = intersect(
        first[0], first[1], first[2:6].reshape(2, 2), second[0], second[1], second[2:6].reshape(2, 2)
    )
    distance = math.hypot(x, y)
    reach = max(rays.range[last], rays.range[following])
    if not distance < CORNER_RANGE * reach + CORNER_RANGE_SIGMAS * settings.sigma_range:
        return False
    across = (y * y * cxx - 2.0 * x * y * cxy + x * x * cyy) / distance**4
    margin = CORNER_STEPS * step + CORNER_SIGMAS * (settings.sigma_bearing + math.sqrt(across + first[11]))
    gap = (rays.bearing[following] - rays.bearing[last]) % TURN
    bearing = (math.atan2(y, x) - rays.bearing[last] + math.pi) % TURN - math.pi
    if gap > MAX_BEARING_GAP + step or not -margin <= bearing <= gap + margin:
        return False
    if cxx + cyy > CORNER_DEVIATION**2:
        return False
    begin, end = found.spans[before, 3], found.spans[before, 4] + 1
    start, stop = found.spans[after, 3], found.spans[after, 4] + 1
    if start < begin:
        start, stop = start + count, stop + count
    row = found.corners[corners]
    row[0], row[1], row[2], row[3], row[4], row[5] = x, y, cxx, cxy, cxy, cyy
    row[6] = evidence(rays, count, first, second, begin, end, start, stop, settings)
    found.pairs[corners, 0], found.pairs[corners, 1] = before, after
    return True


@compiled
def fit_all(
    rays: Rays, count: int, pieces: Pieces, made: int, room: Part, settings: Settings, found: Found
) -> tuple[int, float]:
    """Fit the pieces in the order of their beams; the number of lines, and the range variance they show, or NaN."""
    start = 0
    for piece in range(1, made):
        if rays.beam[wrap(pieces.begin[piece], count)] < rays.beam[wrap(pieces.begin[start], count)]:
            start = piece
    lines = shown = 0
    for k in range(start, start + made):
        is_line, variance = fit_piece(rays, count, pieces, wrap(k, made), room, settings, found, lines)
        if is_line:
            lines += 1
        if math.isfinite(variance):
            insert(found.evidence, shown, variance)
            shown += 1
    return lines, 0.5 * (found.evidence[(shown - 1) // 2] + found.evidence[shown // 2]) if shown > 0 else math.nan


@compiled
def insert(values: Floats, count: int, value: float) -> None:
    """Put a value among `count` sorted ones."""
    k = count
    while k > 0 and values[k - 1] > value:
        values[k] = values[k - 1]
        k -= 1
    values[k] = value


@compiled
def condense(
    ranges: Floats,
    angles: Floats,
    setting_values: tuple[Any, ...],
    memory: tuple[Floats, Integers, Floats, Integers],
    found_arrays: tuple[Any, ...],
) -> tuple[int, int, float]:
    """Numbers of lines and corners written into the arrays, and the range variance that the scan shows, or NaN.

    Settings and Found come as plain tuples: to pass the names of their fields costs a microsecond each. `memory` is
    what `rays.allocate` and `pieces.allocate` gave.
    """
    settings, found = Settings(*setting_values), Found(*found_arrays)
    grid, space = ray_views(memory[0], memory[1])
    pieces, gains, stack = piece_views(memory[2], memory[3])
    update_grid(angles, grid)
    closest = max(settings.range_min, CLOSEST * settings.sigma_range)
    rays, count = select(ranges, closest, settings.range_max, grid, space)
    if count < settings.minimum_count:
        return 0, 0, math.nan
    step = spacing(angles, rays, count)
    mark_breaks(rays, count, step, settings)
    accumulate(rays, count, step, settings)
    if settings.tracking_distance > 0.0:
        made = drop_small(pieces, track(rays, count, settings.tracking_distance, pieces))
        pieces.spread[:, :made] = 0.0
    else:
        made = segment(rays, count, step, pieces, gains, stack, settings)
    # gains and prefix sums are used up; their memory holds the rays of one piece at a time
    room = Part(gains, rays.prefix[0], rays.prefix[1])
    lines, variance = fit_all(rays, count, pieces, made, room, settings, found)
    corners = 0
    for after in range(lines):
        before = after - 1 if after > 0 else lines - 1
        if before != after and find_corner(rays, count, step, found, before, after, settings, corners):
            corners += 1
    corners = leave_out(found.corners, found.pairs, found.curved, corners)
    return lines, corners, variance

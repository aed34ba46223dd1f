"""Neighbouring pieces that are one wall: merging, and bridging of spurious returns.

The test is exact: the increase of chi-square by giving two pieces one line is the Mahalanobis distance of their lines.
"""

from __future__ import annotations

from .compiled import compiled
from .pieces import Pieces, absorb, add, copy, cost, joint_line, line
from .rays import MAX_BEARING_GAP, MISSING_STEPS, TURN, Rays, distance_squared, wrap
from .settings import Settings
from .sums import over
from .types import Integers

MIN_SOLID = 4
"""Rays below which a piece is taken for spurious: two parameters are fitted, so that fewer are no evidence."""

MAX_BRIDGED = 4
"""Rays that may lie off a wall between two parts of it."""

REACH = 9.0
"""Squared normalised residual up to which a free ray is given to the line beside it: three standard deviations."""

ADJOINING = -1
"""In place of a number of rays between two pieces: none, and no break either."""

PASSES = 4
"""Sweeps over all neighbours for merging; two settle nearly every scan."""


@compiled
def one_line(pieces: Pieces, i: int, j: int, penalty: float) -> bool:
    """Whether one line explains pieces i and j."""
    return joint_line(pieces, i, j)[2] - cost(pieces, i) - cost(pieces, j) < penalty


@compiled
def bridgeable(
    rays: Rays, count: int, step: float, pieces: Pieces, i: int, j: int, between: int, settings: Settings
) -> bool:
    """Whether the `between` rays from piece i to piece j leave no opening in the one wall that they may be."""
    last, following = wrap(pieces.end[i] - 1, count), wrap(pieces.begin[j], count)
    gap = rays.bearing[following] - rays.bearing[last]
    if gap < 0.0:
        gap += TURN
    if gap > MAX_BEARING_GAP:
        return False
    if distance_squared(rays, last, following) <= settings.maximum_gap**2:
        return True
    # wider than an opening that may be bridged: at grazing incidence a single lost ray may leave that
    if gap > MISSING_STEPS * step:
        return False
    u, v, _ = joint_line(pieces, i, j)
    for k in range(pieces.end[i], pieces.end[i] + between):
        ray = wrap(k, count)
        if rays.inverse[ray] < u * rays.cos[ray] + v * rays.sin[ray]:  # it passed where the wall should be
            return False
    return True


@compiled
def left_out(pieces: Pieces, broken: Integers, count: int, i: int, j: int, shift: int) -> int:
    """Rays from piece i to the next piece j, which count `shift` further; ADJOINING where a wall could just go on."""
    between = pieces.begin[j] + shift - pieces.end[i]
    return between if between > 0 or broken[wrap(pieces.begin[j], count)] != 0 else ADJOINING


@compiled
def merge(rays: Rays, count: int, step: float, pieces: Pieces, made: int, bridge: bool, settings: Settings) -> int:
    """Join neighbours that are one wall, across spurious rays too if `bridge`; the number of pieces left."""
    most = MAX_BRIDGED if bridge else ADJOINING
    penalty, broken = settings.penalty, rays.broken
    for _ in range(PASSES):
        before = made
        kept = 0
        for i in range(1, made + 1):
            ends = i == made  # the last piece may continue in the first, across the start of the revolution
            j, shift = (0, count) if ends else (i, 0)
            if kept == j:
                break
            between = left_out(pieces, broken, count, kept, j, shift)
            one_wall = between <= most and one_line(pieces, kept, j, penalty)
            if one_wall and between != ADJOINING:
                one_wall = bridgeable(rays, count, step, pieces, kept, j, between, settings)
            if one_wall:
                absorb(pieces, kept, j, between == ADJOINING, shift)
                if ends:
                    for k in range(kept):
                        copy(pieces, k + 1, k)
                    kept -= 1
            elif not ends:
                kept += 1
                copy(pieces, i, kept)
        made = min(made, kept + 1)
        if made == before:
            break
    return made


@compiled
def drop_small(pieces: Pieces, made: int) -> int:
    """Leave out the pieces that are too small to be evidence; the number left."""
    kept = 0
    for i in range(made):
        if pieces.end[i] - pieces.begin[i] >= MIN_SOLID:
            copy(pieces, i, kept)
            kept += 1
    return kept


@compiled
def reaches(rays: Rays, ray: int, u: float, v: float, settings: Settings) -> bool:
    """Whether a ray lies on the line (u, v) within three standard deviations."""
    p, t = u * rays.cos[ray] + v * rays.sin[ray], v * rays.cos[ray] - u * rays.sin[ray]
    residual = rays.inverse[ray] - p
    range_variance = settings.sigma_range**2 + settings.roughness**2
    variance = range_variance * p * p * p * p + (settings.sigma_bearing * t) ** 2
    return bool(residual * residual <= REACH * variance)


@compiled
def extend(rays: Rays, count: int, pieces: Pieces, made: int, settings: Settings) -> None:
    """Give the rays of dropped pieces that lie on a neighbouring line to it, from its ends outwards."""
    for i in range(made):
        u, v = line(pieces, i)
        limit = pieces.begin[i + 1] if i + 1 < made else pieces.begin[0] + count
        end = pieces.end[i]
        while end < limit and rays.broken[wrap(end, count)] == 0 and reaches(rays, wrap(end, count), u, v, settings):
            end += 1
        if pieces.head[i] == pieces.end[i]:
            pieces.head[i] = end
        add(pieces, i, over(rays.prefix, count, pieces.end[i], end))
        pieces.end[i] = end
        limit = pieces.end[i - 1] if i > 0 else max(0, pieces.end[made - 1] - count)
        begin = pieces.begin[i]
        while begin > limit and rays.broken[wrap(begin, count)] == 0:
            if not reaches(rays, wrap(begin - 1, count), u, v, settings):
                break
            begin -= 1
        if pieces.tail[i] == pieces.begin[i]:
            pieces.tail[i] = begin
        add(pieces, i, over(rays.prefix, count, begin, pieces.begin[i]))
        pieces.begin[i] = begin

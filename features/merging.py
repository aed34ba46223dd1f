"""Neighbouring pieces that are one wall: merging, and bridging of spurious returns.

The test is exact: the increase of chi-square by giving two pieces one line is the Mahalanobis distance of their lines.
"""

from __future__ import annotations

from .compiled import compiled
from .pieces import Pieces, absorb, add_rays, copy, cost, joint_line, line
from .rays import MAX_BEARING_GAP, MISSING_STEPS, TURN, Rays, distance_squared, wrap
from .settings import Settings

MIN_SOLID = 4
"""Rays below which a piece is taken for spurious: two parameters are fitted, so that fewer are no evidence."""

MAX_BRIDGED = 4
"""Rays that may lie off a wall between two parts of it."""

REACH = 9.0
"""Squared normalised residual up to which a free ray is given to the line beside it: three standard deviations."""

PASSES = 4
"""Sweeps over all neighbours for merging; two settle nearly every scan."""


@compiled
def one_wall(
    rays: Rays, count: int, step: float, pieces: Pieces, i: int, j: int, between: int, settings: Settings
) -> bool:
    """Whether piece j continues the wall of piece i before it, `between` rays having been left out."""
    u, v, joint = joint_line(pieces, i, j)
    if not joint - cost(pieces, i) - cost(pieces, j) < settings.penalty:
        return False
    last, following = wrap(pieces.end[i] - 1, count), wrap(pieces.begin[j], count)
    if between == 0 and rays.broken[following] == 0:
        return True
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
    for k in range(pieces.end[i], pieces.end[i] + between):
        m = wrap(k, count)
        if rays.inverse[m] < u * rays.cos[m] + v * rays.sin[m]:  # the ray passed where the wall should be
            return False
    return True


@compiled
def merge(rays: Rays, count: int, step: float, pieces: Pieces, made: int, bridge: bool, settings: Settings) -> int:
    """Join neighbours that are one wall, across spurious rays too if `bridge`; the number of pieces left."""
    for _ in range(PASSES):
        before = made
        kept = 0
        for i in range(1, made):
            between = pieces.begin[i] - pieces.end[kept]
            adjacent = between == 0 and rays.broken[wrap(pieces.begin[i], count)] == 0
            if (adjacent or (bridge and between <= MAX_BRIDGED)) and one_wall(
                rays, count, step, pieces, kept, i, between, settings
            ):
                absorb(pieces, kept, i, adjacent, 0)
            else:
                kept += 1
                copy(pieces, i, kept)
        made = merge_ends(rays, count, step, pieces, min(made, kept + 1), bridge, settings)
        if made == before:
            break
    return made


@compiled
def merge_ends(rays: Rays, count: int, step: float, pieces: Pieces, made: int, bridge: bool, settings: Settings) -> int:
    """Join the last piece with the first where they are one wall across the start of the revolution."""
    if made < 2:
        return made
    between = pieces.begin[0] + count - pieces.end[made - 1]
    adjacent = between == 0 and rays.broken[wrap(pieces.begin[0], count)] == 0
    if not (adjacent or (bridge and between <= MAX_BRIDGED)):
        return made
    if not one_wall(rays, count, step, pieces, made - 1, 0, between, settings):
        return made
    absorb(pieces, made - 1, 0, adjacent, count)
    for i in range(1, made):
        copy(pieces, i, i - 1)
    return made - 1


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
        add_rays(rays.prefix, count, pieces.end[i], end, 1.0, pieces.sums[i])
        pieces.end[i] = end
        limit = pieces.end[i - 1] if i > 0 else max(0, pieces.end[made - 1] - count)
        begin = pieces.begin[i]
        while begin > limit and rays.broken[wrap(begin, count)] == 0:
            if not reaches(rays, wrap(begin - 1, count), u, v, settings):
                break
            begin -= 1
        if pieces.tail[i] == pieces.begin[i]:
            pieces.tail[i] = begin
        add_rays(rays.prefix, count, begin, pieces.begin[i], 1.0, pieces.sums[i])
        pieces.begin[i] = begin

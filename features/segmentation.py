"""Where one wall ends and the next begins: optimal binary splitting, merging, and bridging of spurious returns.

The cost of an interval of rays is the chi-square of its best line, had in constant time from prefix sums (see rays).
A run between certain breaks is split where the costs of the two parts add up to the least, as long as that gains more
than a penalty; neighbours whose common line costs less than the penalty are merged. The merging test is exact: the
increase of chi-square equals the Mahalanobis distance of the two lines.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .compiled import compiled, vectorised
from .rays import MAX_BEARING_GAP, MISSING_STEPS, TURN, Rays, distance_squared
from .types import Floats, Integers
from .wclm import residual_sum, solve

PENALTY = 30.0
"""Gain of chi-square that a further break must bring. A break adds two line parameters and a position to choose among
n: about 3 ln n, half as much again against the break that noise likes best."""

MIN_PIECE = 2
"""Rays on either side of a split; two rays define a line."""

MIN_SOLID = 4
"""Rays below which a piece is taken for spurious: two parameters are fitted, so that fewer are no evidence."""

MAX_BRIDGED = 4
"""Rays that may lie off a wall between two parts of it."""

REFINE_WINDOW = 12
"""Rays to either side over which a boundary is moved to where both neighbours fit best."""

REACH = 9.0
"""Squared normalised residual up to which a free ray is given to the line beside it: three standard deviations."""

PASSES = 4
"""Sweeps over all neighbours for merging; one settles nearly every scan."""


class Pieces(NamedTuple):
    """Intervals of rays in order, none overlapping; the last may run over ray n (see rays)."""

    begin: Integers
    end: Integers  # one past the last ray
    head: Integers  # end of the first uninterrupted run of rays
    tail: Integers  # begin of the last uninterrupted run
    sums: Floats  # (pieces, 6) of the rays that belong to the piece; bridged rays do not


def allocate(beams: int) -> tuple[Floats, Floats, Integers]:
    """Memory for scans of up to `beams` beams: sums, costs of splits, and integers."""
    return np.zeros((beams + 1, 6)), np.zeros(beams + 1), np.zeros((5, 2 * beams + 2), dtype=np.int64)


@compiled
def views(sums: Floats, integers: Integers) -> tuple[Pieces, Integers]:
    """Pieces in the memory that `allocate` gave, and a stack."""
    return Pieces(integers[0], integers[1], integers[2], integers[3], sums), integers[4]


@compiled
def chi_square(prefix: Floats, begin: int, end: int) -> float:
    """Chi-square of the best line through rays begin..end-1, end <= n; any two rays fit exactly."""
    if end - begin <= 2:
        return 0.0
    return residual_sum(
        prefix[0, end] - prefix[0, begin],
        prefix[1, end] - prefix[1, begin],
        prefix[2, end] - prefix[2, begin],
        prefix[3, end] - prefix[3, begin],
        prefix[4, end] - prefix[4, begin],
        prefix[5, end] - prefix[5, begin],
    )


@compiled
def chi_square_of(sums: Floats) -> float:
    """Chi-square of the best line from its six sums."""
    return residual_sum(sums[0], sums[1], sums[2], sums[3], sums[4], sums[5])


@compiled
def add_rays(prefix: Floats, count: int, begin: int, end: int, sign: float, sums: Floats) -> None:
    """Add (or subtract, by `sign`) the sums of rays begin..end-1 of n = `count`; end may exceed n."""
    for row in range(6):
        total = prefix[row, min(end, count)] - prefix[row, min(begin, count)]
        if end > count:
            total += prefix[row, end - count] - prefix[row, max(begin - count, 0)]
        sums[row] += sign * total


@vectorised
def explained(prefix: Floats, low: int, high: int, origin: Floats, terminus: Floats, gains: Floats) -> None:
    """Into gains[k], k = low..high: what two lines parted at ray k explain of the weighted sum of (1/range)^2.

    The sums of the line before the boundary are prefix[:, k] - origin, of the line after it terminus - prefix[:, k].
    A line explains A/D = Re(conj(B) H), with D from `solve`; two of them, on one denominator,
    (A1 D2 + A2 D1) / (D1 D2).
    """
    w0, x0, y0, p0, q0 = origin[0], origin[1], origin[2], origin[3], origin[4]
    w1, x1, y1, p1, q1 = terminus[0], terminus[1], terminus[2], terminus[3], terminus[4]
    # contiguous views indexed from 0, which the compiler can prove to be in range and so vectorises
    weight, er, ei = prefix[0][low : high + 1], prefix[1][low : high + 1], prefix[2][low : high + 1]
    hr, hi, values = prefix[3][low : high + 1], prefix[4][low : high + 1], gains[low : high + 1]
    for k in range(len(values)):
        w, x, y, p, q = weight[k], er[k], ei[k], hr[k], hi[k]
        wl, xl, yl, pl, ql = w - w0, x - x0, y - y0, p - p0, q - q0
        wr, xr, yr, pr, qr = w1 - w, x1 - x, y1 - y, p1 - p, q1 - q
        dl = wl * wl - xl * xl - yl * yl
        dr = wr * wr - xr * xr - yr * yr
        al = wl * (pl * pl + ql * ql) - xl * (pl * pl - ql * ql) - 2.0 * yl * pl * ql
        ar = wr * (pr * pr + qr * qr) - xr * (pr * pr - qr * qr) - 2.0 * yr * pr * qr
        values[k] = 2.0 * (al * dr + ar * dl) / (dl * dr)


@compiled
def largest(values: Floats, low: int, high: int) -> int:
    """Index of the largest of values[low..high], or -1 where none is a number."""
    best, position = -math.inf, -1
    for k in range(low, high + 1):
        if values[k] > best:
            best, position = values[k], k
    return position


@compiled
def best_split(prefix: Floats, begin: int, end: int, penalty: float, gains: Floats) -> int:
    """Where to split begin..end, or -1 where no split gains more than the penalty."""
    if end - begin < 2 * MIN_PIECE:
        return -1
    whole = chi_square(prefix, begin, end)
    if whole <= penalty:  # nothing can gain more than all of it
        return -1
    low, high = begin + MIN_PIECE, end - MIN_PIECE
    explained(prefix, low, high, prefix[:, begin], prefix[:, end], gains)
    position = largest(gains, low, high)
    if position < 0:
        return -1
    parted = prefix[5, end] - prefix[5, begin] - gains[position]
    return position if whole - parted > penalty else -1


@compiled
def append(pieces: Pieces, made: int, begin: int, end: int) -> int:
    """Add the interval begin..end as one piece; the new number of pieces. Its sums are left to the caller."""
    pieces.begin[made], pieces.end[made] = begin, end
    pieces.head[made], pieces.tail[made] = end, begin
    return made + 1


@compiled
def split(rays: Rays, count: int, penalty: float, pieces: Pieces, gains: Floats, stack: Integers) -> int:
    """Split all rays into pieces at the breaks and, between breaks, where two lines fit better; their number."""
    made = 0
    run = 0
    while run < count:
        stop = run + 1
        while stop < count and rays.broken[stop] == 0:
            stop += 1
        stack[0], stack[1] = run, stop
        depth = 2
        while depth > 0:
            depth -= 2
            begin, end = stack[depth], stack[depth + 1]
            position = best_split(rays.prefix, begin, end, penalty, gains)
            if position < 0:
                made = append(pieces, made, begin, end)
                continue
            stack[depth], stack[depth + 1] = position, end
            stack[depth + 2], stack[depth + 3] = begin, position
            depth += 4
        run = stop
    for i in range(made):
        pieces.sums[i, :] = 0.0
        add_rays(rays.prefix, count, pieces.begin[i], pieces.end[i], 1.0, pieces.sums[i])
    return made


@compiled
def cost(pieces: Pieces, i: int) -> float:
    """Chi-square of piece i."""
    return chi_square_of(pieces.sums[i]) if pieces.end[i] - pieces.begin[i] > 2 else 0.0


@compiled
def joint_line(pieces: Pieces, i: int, j: int) -> tuple[float, float, float]:
    """(u, v, chi-square) of the one line through pieces i and j."""
    first, second = pieces.sums[i], pieces.sums[j]
    w, x, y = first[0] + second[0], first[1] + second[1], first[2] + second[2]
    p, q, k = first[3] + second[3], first[4] + second[4], first[5] + second[5]
    u, v, _ = solve(w, x, y, p, q)
    return u, v, max(0.0, k - u * p - v * q) if math.isfinite(u) else math.inf


@compiled
def one_wall(
    rays: Rays, count: int, pieces: Pieces, i: int, j: int, penalty: float, max_gap: float, step: float
) -> bool:
    """Whether piece j continues the wall of piece i, the piece before it."""
    last = (pieces.end[i] - 1) % count
    next_ray = pieces.begin[j] % count
    between = (next_ray - last - 1) % count
    if between > MAX_BRIDGED:
        return False
    gap = (rays.bearing[next_ray] - rays.bearing[last]) % TURN
    if gap > MAX_BEARING_GAP:
        return False
    u, v, joint = joint_line(pieces, i, j)
    if not joint - cost(pieces, i) - cost(pieces, j) < penalty:
        return False
    if between == 0 and rays.broken[next_ray] == 0:
        return True
    if distance_squared(rays, last, next_ray) <= max_gap * max_gap:
        return True
    # wider than an opening that may be bridged, as one lost ray leaves it at grazing incidence
    if gap > MISSING_STEPS * step:
        return False
    for k in range(last + 1, last + 1 + between):
        m = k % count
        predicted = u * rays.cos[m] + v * rays.sin[m]
        if rays.inverse[m] < predicted:  # the ray passed through where the wall should be
            return False
    return True


@compiled
def merge(
    rays: Rays, count: int, pieces: Pieces, made: int, penalty: float, max_gap: float, step: float, bridge: bool
) -> int:
    """Join neighbours that are one wall, across spurious rays too if `bridge`; the number of pieces left."""
    for _ in range(PASSES):
        before = made
        kept = 0
        for i in range(1, made):
            adjacent = pieces.end[kept] == pieces.begin[i] and rays.broken[pieces.begin[i]] == 0
            if (adjacent or bridge) and one_wall(rays, count, pieces, kept, i, penalty, max_gap, step):
                absorb(pieces, kept, i, adjacent, 0)
            else:
                kept += 1
                copy(pieces, i, kept)
        made = min(made, kept + 1)
        if made > 1 and pieces.end[made - 1] <= count:
            adjacent = pieces.end[made - 1] == pieces.begin[0] + count and rays.broken[pieces.begin[0]] == 0
            if (adjacent or bridge) and one_wall(rays, count, pieces, made - 1, 0, penalty, max_gap, step):
                absorb(pieces, made - 1, 0, adjacent, count)
                for i in range(1, made):
                    copy(pieces, i, i - 1)
                made -= 1
        if made == before:
            break
    return made


@compiled
def absorb(pieces: Pieces, i: int, j: int, adjacent: bool, shift: int) -> None:
    """Make piece i end with piece j, whose rays count `shift` further."""
    if adjacent:
        if pieces.head[i] == pieces.end[i]:
            pieces.head[i] = pieces.head[j] + shift
        if pieces.tail[j] != pieces.begin[j]:
            pieces.tail[i] = pieces.tail[j] + shift
    else:
        pieces.tail[i] = pieces.tail[j] + shift
    pieces.end[i] = pieces.end[j] + shift
    for row in range(6):
        pieces.sums[i, row] += pieces.sums[j, row]


@compiled
def copy(pieces: Pieces, source: int, target: int) -> None:
    """Overwrite piece `target` with piece `source`."""
    if source == target:
        return
    pieces.begin[target], pieces.end[target] = pieces.begin[source], pieces.end[source]
    pieces.head[target], pieces.tail[target] = pieces.head[source], pieces.tail[source]
    for row in range(6):
        pieces.sums[target, row] = pieces.sums[source, row]


@compiled
def refine(rays: Rays, count: int, pieces: Pieces, made: int, gains: Floats) -> None:
    """Move every boundary between adjoining pieces to where the two lines together fit best."""
    for i in range(made):
        j = i + 1 if i + 1 < made else 0
        shift = count if j == 0 else 0
        boundary = pieces.end[i]
        if j == i or boundary != pieces.begin[j] + shift or rays.broken[boundary % count] != 0:
            continue
        low = max(pieces.tail[i] + MIN_PIECE, boundary - REFINE_WINDOW)
        high = min(pieces.head[j] + shift - MIN_PIECE, boundary + REFINE_WINDOW)
        position = best_boundary(rays.prefix, count, pieces, i, j, low, high, gains)
        if position > 0:
            move_boundary(rays, count, pieces, i, j, position, shift)
    if made > 1 and pieces.begin[0] < 0:
        rotate(pieces, made, count)


@compiled
def best_boundary(
    prefix: Floats, count: int, pieces: Pieces, i: int, j: int, low: int, high: int, gains: Floats
) -> int:
    """The ray low..high at which pieces i and j are best parted, or -1; low..high may run over ray n = `count`."""
    boundary, seam = pieces.end[i], prefix[:, count]
    at = prefix[:, boundary] if boundary <= count else seam + prefix[:, boundary - count]
    origin, terminus = at - pieces.sums[i], at + pieces.sums[j]
    best, position = -math.inf, -1
    if low <= count:
        explained(prefix, low, min(high, count), origin, terminus, gains)
        position = largest(gains, low, min(high, count))
        best = gains[position] if position >= 0 else best
    if high > count:
        first = max(low, count + 1) - count
        explained(prefix, first, high - count, origin - seam, terminus - seam, gains)
        beyond = largest(gains, first, high - count)
        if beyond >= 0 and gains[beyond] > best:
            position = beyond + count
    return position


@compiled
def rotate(pieces: Pieces, made: int, count: int) -> None:
    """Make the first piece the last, where a boundary moved back over ray 0."""
    copy(pieces, 0, made)
    pieces.begin[made] += count
    pieces.end[made] += count
    pieces.head[made] += count
    pieces.tail[made] += count
    for i in range(made):
        copy(pieces, i + 1, i)


@compiled
def move_boundary(rays: Rays, count: int, pieces: Pieces, i: int, j: int, position: int, shift: int) -> None:
    """Let piece i end and piece j, which counts `shift` less, begin at ray `position`."""
    boundary = pieces.end[i]
    if position == boundary:
        return
    sign = 1.0 if position > boundary else -1.0
    low, high = min(position, boundary), max(position, boundary)
    add_rays(rays.prefix, count, low, high, sign, pieces.sums[i])
    add_rays(rays.prefix, count, low, high, -sign, pieces.sums[j])
    if pieces.head[i] == boundary:
        pieces.head[i] = position
    if pieces.tail[j] == pieces.begin[j]:
        pieces.tail[j] = position - shift
    pieces.end[i] = position
    pieces.begin[j] = position - shift


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
def reaches(rays: Rays, ray: int, u: float, v: float, range_variance: float, bearing_variance: float) -> bool:
    """Whether a ray lies on the line (u, v) within three standard deviations."""
    c, s = rays.cos[ray], rays.sin[ray]
    p, t = u * c + v * s, v * c - u * s
    residual = rays.inverse[ray] - p
    return residual * residual <= REACH * (range_variance * p * p * p * p + bearing_variance * t * t)


@compiled
def extend(rays: Rays, count: int, pieces: Pieces, made: int, sigma_range: float, sigma_bearing: float) -> None:
    """Give the rays of dropped pieces that lie on a neighbouring line to it, from its end outwards."""
    rv, bv = sigma_range * sigma_range, sigma_bearing * sigma_bearing
    for i in range(made):
        u, v, _ = solve(pieces.sums[i, 0], pieces.sums[i, 1], pieces.sums[i, 2], pieces.sums[i, 3], pieces.sums[i, 4])
        limit = pieces.begin[i + 1] if i + 1 < made else pieces.begin[0] + count
        end = pieces.end[i]
        while end < limit and rays.broken[end % count] == 0 and reaches(rays, end % count, u, v, rv, bv):
            end += 1
        if pieces.head[i] == pieces.end[i]:
            pieces.head[i] = end
        add_rays(rays.prefix, count, pieces.end[i], end, 1.0, pieces.sums[i])
        pieces.end[i] = end
        limit = pieces.end[i - 1] if i > 0 else max(0, pieces.end[made - 1] - count)
        begin = pieces.begin[i]
        while begin > limit and rays.broken[begin % count] == 0 and reaches(rays, begin - 1, u, v, rv, bv):
            begin -= 1
        if pieces.tail[i] == pieces.begin[i]:
            pieces.tail[i] = begin
        add_rays(rays.prefix, count, begin, pieces.begin[i], 1.0, pieces.sums[i])
        pieces.begin[i] = begin


@compiled
def segment(
    rays: Rays,
    count: int,
    pieces: Pieces,
    gains: Floats,
    stack: Integers,
    penalty: float,
    max_gap: float,
    step: float,
    sigma_range: float,
    sigma_bearing: float,
) -> int:
    """Divide the rays of a scan into walls; their number. What belongs to no wall is in no piece."""
    made = split(rays, count, penalty, pieces, gains, stack)
    made = merge(rays, count, pieces, made, penalty, max_gap, step, False)
    refine(rays, count, pieces, made, gains)
    made = drop_small(pieces, made)
    extend(rays, count, pieces, made, sigma_range, sigma_bearing)
    made = merge(rays, count, pieces, made, penalty, max_gap, step, True)
    refine(rays, count, pieces, made, gains)
    return made

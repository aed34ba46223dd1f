"""Breaks between walls where the rays say they are: optimal binary splitting and the refinement of boundaries.

The cost of an interval of rays is the chi-square of its best line, had in constant time from prefix sums (see rays).
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled, vectorised
from .pieces import Pieces, append, rotate
from .rays import TURN, Rays, wrap
from .sums import Sums, at, minus, over, plus, put, residual_sum, solve, up_to
from .types import Floats, Integers

MIN_PIECE = 2
"""Rays on either side of a split; two rays define a line."""

LEAST_LIKELY = 9.0
"""Chi-square by which a boundary may be worse than the best one and still count: a likelihood of one in 90."""

REFINE_WINDOW = 12
"""Rays to either side over which a boundary is moved to where both neighbours fit best."""

INFINITY_BITS = 0x7FF0000000000000
"""Infinity's, read as an integer."""


@compiled
def chi_square(prefix: Floats, begin: int, end: int) -> float:
    """Chi-square of the best line through rays begin..end-1, end <= n; any two rays fit exactly."""
    return residual_sum(minus(at(prefix, end), at(prefix, begin))) if end - begin > 2 else 0.0


@vectorised
def explained(prefix: Floats, low: int, high: int, origin: Sums, terminus: Sums, gains: Floats) -> None:
    """Into gains[k], k = low..high: what two lines parted at ray k explain of the weighted sum of (1/range)^2.

    The sums of the line before the boundary are column k - origin, of the line after it terminus - column k.
    A line explains A/D = Re(conj(B) H), with D from `solve`; two of them, on one denominator,
    (A1 D2 + A2 D1) / (D1 D2).
    """
    w0, x0, y0, p0, q0, _ = origin
    w1, x1, y1, p1, q1, _ = terminus
    # contiguous views indexed from 0, which the compiler can prove to be in range and so vectorises
    weight, er, ei = prefix[0][low : high + 1], prefix[1][low : high + 1], prefix[2][low : high + 1]
    hr, hi, values = prefix[3][low : high + 1], prefix[4][low : high + 1], gains[low : high + 1]
    for k in range(len(values)):
        w, x, y, p, q = weight[k], er[k], ei[k], hr[k], hi[k]
        wl, xl, yl, pl, ql = w - w0, x - x0, y - y0, p - p0, q - q0
        wr, xr, yr, pr, qr = w1 - w, x1 - x, y1 - y, p1 - p, q1 - q
        dl = wl * wl - xl * xl - yl * yl
        dr = wr * wr - xr * xr - yr * yr
        al = (wl - xl) * pl * pl + (wl + xl) * ql * ql - 2.0 * yl * pl * ql
        ar = (wr - xr) * pr * pr + (wr + xr) * qr * qr - 2.0 * yr * pr * qr
        values[k] = 2.0 * (al * dr + ar * dl) / (dl * dr)


@vectorised
def largest(values: Floats, low: int, high: int) -> int:
    """Index of the largest of values[low..high], or -1 where none is positive.

    Positive numbers are in the order of their bits, and of integers a vector unit finds the largest; of floats it does
    not, for NaN's sake. Where not negative, the bits of NaN are beyond those of infinity.
    """
    bits = values[low : high + 1].view(np.int64)
    best = 1
    for k in range(len(bits)):
        best = max(best, bits[k] if bits[k] <= INFINITY_BITS else 0)
    for k in range(len(bits)):
        if bits[k] == best:
            return low + k
    return -1


@compiled
def best_split(prefix: Floats, begin: int, end: int, penalty: float, gains: Floats) -> int:
    """Where to split begin..end, or -1 where no split gains more than the penalty."""
    if end - begin < 2 * MIN_PIECE:
        return -1
    whole = chi_square(prefix, begin, end)
    if whole <= penalty:  # nothing can gain more than all of it
        return -1
    low, high = begin + MIN_PIECE, end - MIN_PIECE
    explained(prefix, low, high, at(prefix, begin), at(prefix, end), gains)
    position = largest(gains, low, high)
    if position < 0:
        return -1
    parted = prefix[5, end] - prefix[5, begin] - gains[position]
    return position if whole - parted > penalty else -1


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
        put(pieces.sums, i, over(rays.prefix, count, pieces.begin[i], pieces.end[i]))
    return made


@compiled
def refine(rays: Rays, count: int, pieces: Pieces, made: int, gains: Floats) -> None:
    """Move every boundary between adjoining pieces to where the two lines together fit best."""
    prefix = rays.prefix
    pieces.spread[:, :made] = 0.0
    for i in range(made):
        j = i + 1 if i + 1 < made else 0
        shift = count if j == 0 else 0
        boundary = pieces.end[i]
        if j == i or boundary != pieces.begin[j] + shift or rays.broken[wrap(boundary, count)] != 0:
            continue
        low = max(pieces.tail[i] + MIN_PIECE, boundary - REFINE_WINDOW)
        high = min(pieces.head[j] + shift - MIN_PIECE, boundary + REFINE_WINDOW)
        middle = up_to(prefix, count, boundary)
        origin, terminus = minus(middle, at(pieces.sums, i)), plus(middle, at(pieces.sums, j))
        position = best_boundary(prefix, count, low, high, origin, terminus, gains)
        if position > 0:
            add_spread(rays, count, low, high, position, origin, terminus, gains, pieces, i, j)
            if position != boundary:
                move_boundary(prefix, count, pieces, i, j, position, shift)
    if made > 1 and pieces.begin[0] < 0:
        rotate(pieces, made, count)


@compiled
def best_boundary(prefix: Floats, count: int, low: int, high: int, origin: Sums, terminus: Sums, gains: Floats) -> int:
    """The ray low..high at which two lines are best parted, or -1; as `explained`, but may run over ray n = `count`."""
    best, position = -math.inf, -1
    if low <= count:
        explained(prefix, low, min(high, count), origin, terminus, gains)
        position = largest(gains, low, min(high, count))
        best = gains[position] if position >= 0 else best
    if high > count:
        first = max(low, count + 1) - count
        seam = at(prefix, count)
        explained(prefix, first, high - count, minus(origin, seam), minus(terminus, seam), gains)
        beyond = largest(gains, first, high - count)
        if beyond >= 0 and gains[beyond] > best:
            position = beyond + count
    return position


@compiled
def add_spread(
    rays: Rays,
    count: int,
    low: int,
    high: int,
    position: int,
    origin: Sums,
    terminus: Sums,
    gains: Floats,
    pieces: Pieces,
    i: int,
    j: int,
) -> None:
    """Add to the spreads of pieces i and j what the choice of ray `position` for the boundary between leaves uncertain.

    A boundary k has the likelihood exp(gain_k / 2). By the law of total variance the lines B_k that go with it add
    sum p_k (B_k - B)(B_k - B)' to the covariance of the lines B that were chosen, and the bearing varies likewise.
    """
    prefix, spread = rays.prefix, pieces.spread
    middle = up_to(prefix, count, position)
    u0, v0, _ = solve(minus(middle, origin))
    u1, v1, _ = solve(minus(terminus, middle))
    chosen, best = unwrapped(rays.bearing, count, position), gain_at(gains, count, position)
    total, wander = 1.0, 0.0
    uu0 = uv0 = vv0 = uu1 = uv1 = vv1 = 0.0
    for k in range(low, high + 1):
        behind = best - gain_at(gains, count, k)
        if not behind < LEAST_LIKELY or k == position:
            continue
        likely = math.exp(-0.5 * behind)
        total += likely
        angle = unwrapped(rays.bearing, count, k) - chosen
        wander += likely * angle * angle
        middle = up_to(prefix, count, k)
        u, v, _ = solve(minus(middle, origin))
        du, dv = u - u0, v - v0
        uu0, uv0, vv0 = uu0 + likely * du * du, uv0 + likely * du * dv, vv0 + likely * dv * dv
        u, v, _ = solve(minus(terminus, middle))
        du, dv = u - u1, v - v1
        uu1, uv1, vv1 = uu1 + likely * du * du, uv1 + likely * du * dv, vv1 + likely * dv * dv
    if math.isfinite(uu0 + vv0 + uu1 + vv1):
        spread[0, i] += uu0 / total
        spread[1, i] += uv0 / total
        spread[2, i] += vv0 / total
        spread[3, i] = wander / total
        spread[0, j] += uu1 / total
        spread[1, j] += uv1 / total
        spread[2, j] += vv1 / total


@compiled
def gain_at(gains: Floats, count: int, k: int) -> float:
    """What `explained` found for a boundary before ray k, which may be one of the next revolution."""
    return float(gains[k] if k <= count else gains[k - count])


@compiled
def unwrapped(bearing: Floats, count: int, k: int) -> float:
    """Bearing of ray k, which may be one of the next revolution."""
    return float(bearing[k] if k < count else bearing[k - count] + TURN)


@compiled
def move_boundary(prefix: Floats, count: int, pieces: Pieces, i: int, j: int, position: int, shift: int) -> None:
    """Let piece i end and piece j, which counts `shift` less, begin at ray `position`."""
    boundary = pieces.end[i]
    moved = over(prefix, count, boundary, position)  # negative where the boundary goes back
    put(pieces.sums, i, plus(at(pieces.sums, i), moved))
    put(pieces.sums, j, minus(at(pieces.sums, j), moved))
    if pieces.head[i] == boundary:
        pieces.head[i] = position
    if pieces.tail[j] == pieces.begin[j]:
        pieces.tail[j] = position - shift
    pieces.end[i] = position
    pieces.begin[j] = position - shift

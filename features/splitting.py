"""Breaks between walls where the rays say they are: optimal binary splitting and the refinement of boundaries.

The cost of an interval of rays is the chi-square of its best line, had in constant time from prefix sums (see rays).
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled, vectorised
from .pieces import Pieces, add_rays, append, rotate
from .rays import TURN, Rays, wrap
from .types import Floats, Integers
from .wclm import residual_sum, solve

MIN_PIECE = 2
"""Rays on either side of a split; two rays define a line."""

LEAST_LIKELY = 9.0
"""Chi-square by which a boundary may be worse than the best one and still count: a likelihood of one in 90."""

REFINE_WINDOW = 12
"""Rays to either side over which a boundary is moved to where both neighbours fit best."""


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
def refine(rays: Rays, count: int, pieces: Pieces, made: int, gains: Floats) -> None:
    """Move every boundary between adjoining pieces to where the two lines together fit best."""
    prefix = rays.prefix
    origin, terminus = np.empty(6), np.empty(6)
    pieces.spread[:made] = 0.0
    for i in range(made):
        j = i + 1 if i + 1 < made else 0
        shift = count if j == 0 else 0
        boundary = pieces.end[i]
        if j == i or boundary != pieces.begin[j] + shift or rays.broken[wrap(boundary, count)] != 0:
            continue
        low = max(pieces.tail[i] + MIN_PIECE, boundary - REFINE_WINDOW)
        high = min(pieces.head[j] + shift - MIN_PIECE, boundary + REFINE_WINDOW)
        for row in range(6):
            at = prefix[row, min(boundary, count)] + (prefix[row, boundary - count] if boundary > count else 0.0)
            origin[row], terminus[row] = at - pieces.sums[i, row], at + pieces.sums[j, row]
        position = best_boundary(prefix, count, low, high, origin, terminus, gains)
        if position > 0:
            add_spread(prefix, rays.bearing, count, low, high, position, origin, terminus, gains, pieces.spread, i, j)
            if position != boundary:
                move_boundary(prefix, count, pieces, i, j, position, shift)
    if made > 1 and pieces.begin[0] < 0:
        rotate(pieces, made, count)


@compiled
def best_boundary(
    prefix: Floats, count: int, low: int, high: int, origin: Floats, terminus: Floats, gains: Floats
) -> int:
    """The ray low..high at which two lines are best parted, or -1; as `explained`, but may run over ray n = `count`."""
    best, position = -math.inf, -1
    if low <= count:
        explained(prefix, low, min(high, count), origin, terminus, gains)
        position = largest(gains, low, min(high, count))
        best = gains[position] if position >= 0 else best
    if high > count:
        first = max(low, count + 1) - count
        seam = prefix[:, count]
        explained(prefix, first, high - count, origin - seam, terminus - seam, gains)
        beyond = largest(gains, first, high - count)
        if beyond >= 0 and gains[beyond] > best:
            position = beyond + count
    return position


@compiled
def add_spread(
    prefix: Floats,
    bearing: Floats,
    count: int,
    low: int,
    high: int,
    position: int,
    origin: Floats,
    terminus: Floats,
    gains: Floats,
    spread: Floats,
    i: int,
    j: int,
) -> None:
    """Add to the spreads of pieces i and j what the choice of ray `position` for the boundary between leaves uncertain.

    A boundary k has the likelihood exp(gain_k / 2). By the law of total variance the lines B_k that go with it add
    sum p_k (B_k - B)(B_k - B)' to the covariance of the lines B that were chosen, and the bearing varies likewise.
    """
    # scalars, and no function that takes arrays: counting the references to those costs more than all the sums
    w0, x0, y0, p0, q0 = origin[0], origin[1], origin[2], origin[3], origin[4]
    w1, x1, y1, p1, q1 = terminus[0], terminus[1], terminus[2], terminus[3], terminus[4]
    best = gains[position - count if position > count else position]
    u0 = v0 = u1 = v1 = chosen = total = wander = 0.0
    uu0 = uv0 = vv0 = uu1 = uv1 = vv1 = 0.0
    for step in range(low - 1, high + 1):
        k = step if step >= low else position  # the lines that were chosen come first; the others are taken about them
        ray = k - count if k > count else k
        behind = best - gains[ray]
        if not behind < LEAST_LIKELY or step == position:
            continue
        w, x, y, p, q = prefix[0, ray], prefix[1, ray], prefix[2, ray], prefix[3, ray], prefix[4, ray]
        angle = bearing[k] if k < count else bearing[k - count] + TURN
        if k > count:
            w, x, y = w + prefix[0, count], x + prefix[1, count], y + prefix[2, count]
            p, q = p + prefix[3, count], q + prefix[4, count]
        ku0, kv0, _ = solve(w - w0, x - x0, y - y0, p - p0, q - q0)
        ku1, kv1, _ = solve(w1 - w, x1 - x, y1 - y, p1 - p, q1 - q)
        if step < low:
            u0, v0, u1, v1, chosen, total = ku0, kv0, ku1, kv1, angle, 1.0
            continue
        likely = math.exp(-0.5 * behind)
        total += likely
        wander += likely * (angle - chosen) * (angle - chosen)
        du, dv = ku0 - u0, kv0 - v0
        uu0, uv0, vv0 = uu0 + likely * du * du, uv0 + likely * du * dv, vv0 + likely * dv * dv
        du, dv = ku1 - u1, kv1 - v1
        uu1, uv1, vv1 = uu1 + likely * du * du, uv1 + likely * du * dv, vv1 + likely * dv * dv
    if math.isfinite(uu0 + vv0 + uu1 + vv1):
        spread[i, 0] += uu0 / total
        spread[i, 1] += uv0 / total
        spread[i, 2] += vv0 / total
        spread[i, 3] = wander / total
        spread[j, 0] += uu1 / total
        spread[j, 1] += uv1 / total
        spread[j, 2] += vv1 / total


@compiled
def move_boundary(prefix: Floats, count: int, pieces: Pieces, i: int, j: int, position: int, shift: int) -> None:
    """Let piece i end and piece j, which counts `shift` less, begin at ray `position`."""
    boundary = pieces.end[i]
    sign = 1.0 if position > boundary else -1.0
    low, high = min(position, boundary), max(position, boundary)
    add_rays(prefix, count, low, high, sign, pieces.sums[i])
    add_rays(prefix, count, low, high, -sign, pieces.sums[j])
    if pieces.head[i] == boundary:
        pieces.head[i] = position
    if pieces.tail[j] == pieces.begin[j]:
        pieces.tail[j] = position - shift
    pieces.end[i] = position
    pieces.begin[j] = position - shift

"""Optimal binary splitting of rays into segments, and refinement of the boundaries between them.

The cost of an interval of rays is the chi-square of its best line, computed in constant time from prefix sums (see
rays).
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import inlined, vectorised
from .normal_equations import (
    Sums,
    add_sums,
    get_column,
    residual_sum,
    set_column,
    solve_line,
    subtract_sums,
    sums_over,
    sums_up_to,
)
from .normal_limits import NORMAL_LIMIT
from .rays import TURN, Rays, wrap_index
from .segments import Segments, append_segment, rotate_segments
from .types import Floats, Integers

# Minimum number of rays on either side of a split. Origin: definition, two rays define a line.
MIN_SPLIT_RAYS = 2

# Chi-square by which a boundary may be worse than the best one and still be considered: a likelihood of 1/90.
MAX_BOUNDARY_CHI2 = NORMAL_LIMIT**2  # Origin: definition.

# Rays to either side within which a boundary is refined. Origin: tuned on simulated scans.
REFINE_WINDOW = 12

# Infinity as an integer with the same bits. Origin: definition, IEEE 754.
INFINITY_BITS = 0x7FF0000000000000


@inlined
def chi_square(prefix: Floats, begin: int, end: int) -> float:
    """Return the chi-square of the best line through rays begin..end-1, end <= n; zero for two rays."""
    return residual_sum(subtract_sums(get_column(prefix, end), get_column(prefix, begin))) if end - begin > 2 else 0.0


@vectorised
def compute_gains(prefix: Floats, low: int, high: int, origin: Sums, terminus: Sums, gains: Floats) -> None:
    """Compute gains[k], k = low..high: the part of the weighted sum of (1/range)^2 explained by two lines that meet at
    ray k.

    The sums of the line before the boundary are column k - origin, of the line after it terminus - column k. A line
    explains A/D = Re(conj(B) H), with D from `solve_line`; two lines, with a common denominator, explain
    (A1 D2 + A2 D1) / (D1 D2).
    """
    w0, x0, y0, p0, q0, _ = origin
    w1, x1, y1, p1, q1, _ = terminus
    # contiguous views indexed from 0: the compiler can prove that they are in range, and vectorises
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
def argmax_positive(values: Floats, low: int, high: int) -> int:
    """Return the index of the largest of values[low..high], or -1 if none is positive.

    Positive numbers are ordered as their bits read as integers. The compiler vectorises the maximum of integers, but
    not that of floats, because of NaN. The bits of a non-negative NaN are greater than those of infinity.
    """
    bits = values[low : high + 1].view(np.int64)
    best = 1
    for k in range(len(bits)):
        best = max(best, bits[k] if bits[k] <= INFINITY_BITS else 0)
    for k in range(len(bits)):
        if bits[k] == best:
            return low + k
    return -1


@inlined
def best_split(prefix: Floats, begin: int, end: int, penalty: float, gains: Floats) -> int:
    """Return the best ray at which to split begin..end, or -1 if no split decreases the cost by the penalty."""
    if end - begin < 2 * MIN_SPLIT_RAYS:
        return -1
    cost = chi_square(prefix, begin, end)
    if cost <= penalty:  # no split can decrease the cost by more than all of it
        return -1
    low, high = begin + MIN_SPLIT_RAYS, end - MIN_SPLIT_RAYS
    compute_gains(prefix, low, high, get_column(prefix, begin), get_column(prefix, end), gains)
    position = argmax_positive(gains, low, high)
    if position < 0:
        return -1
    split_cost = prefix[5, end] - prefix[5, begin] - gains[position]
    return position if cost - split_cost > penalty else -1


@inlined
def split_rays(rays: Rays, count: int, penalty: float, segments: Segments, gains: Floats, stack: Integers) -> int:
    """Split all rays into segments, at breaks and where two lines fit better; return the number of segments.

    count         number of rays
    penalty       decrease of chi-square that a further break must bring
    gains, stack  memory, one entry for each ray
    """
    segment_count = 0
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
                segment_count = append_segment(segments, segment_count, begin, end)
                continue
            stack[depth], stack[depth + 1] = position, end
            stack[depth + 2], stack[depth + 3] = begin, position
            depth += 4
        run = stop
    for i in range(segment_count):
        set_column(segments.sums, i, sums_over(rays.prefix, count, segments.begin[i], segments.end[i]))
    return segment_count


@inlined
def refine_boundaries(rays: Rays, count: int, segments: Segments, segment_count: int, gains: Floats) -> None:
    """Move every boundary between adjacent segments to where both lines together fit best."""
    prefix = rays.prefix
    segments.boundary_covariance[:, :segment_count] = 0.0
    for i in range(segment_count):
        j = i + 1 if i + 1 < segment_count else 0
        shift = count if j == 0 else 0
        boundary = segments.end[i]
        if j == i or boundary != segments.begin[j] + shift or rays.broken[wrap_index(boundary, count)] != 0:
            continue
        low = max(segments.tail[i] + MIN_SPLIT_RAYS, boundary - REFINE_WINDOW)
        high = min(segments.head[j] + shift - MIN_SPLIT_RAYS, boundary + REFINE_WINDOW)
        middle = sums_up_to(prefix, count, boundary)
        origin, terminus = (
            subtract_sums(middle, get_column(segments.sums, i)),
            add_sums(middle, get_column(segments.sums, j)),
        )
        position = best_boundary(prefix, count, low, high, origin, terminus, gains)
        if position > 0:
            add_boundary_covariance(rays, count, low, high, position, origin, terminus, gains, segments, i, j)
            if position != boundary:
                move_boundary(prefix, count, segments, i, j, position, shift)
    if segment_count > 1 and segments.begin[0] < 0:
        rotate_segments(segments, segment_count, count)


@inlined
def best_boundary(prefix: Floats, count: int, low: int, high: int, origin: Sums, terminus: Sums, gains: Floats) -> int:
    """Return the best boundary low..high between two lines, or -1; it may lie beyond ray n = `count`."""
    best, position = -math.inf, -1
    if low <= count:
        compute_gains(prefix, low, min(high, count), origin, terminus, gains)
        position = argmax_positive(gains, low, min(high, count))
        best = gains[position] if position >= 0 else best
    if high > count:
        first = max(low, count + 1) - count
        seam = get_column(prefix, count)
        compute_gains(prefix, first, high - count, subtract_sums(origin, seam), subtract_sums(terminus, seam), gains)
        beyond = argmax_positive(gains, first, high - count)
        if beyond >= 0 and gains[beyond] > best:
            position = beyond + count
    return position


@inlined
def add_boundary_covariance(
    rays: Rays,
    count: int,
    low: int,
    high: int,
    position: int,
    origin: Sums,
    terminus: Sums,
    gains: Floats,
    segments: Segments,
    i: int,
    j: int,
) -> None:
    """Add the covariance due to the uncertain boundary at ray `position` to segments i and j.

    A boundary k has the likelihood exp(gain_k / 2). By the law of total variance its lines B_k add
    sum p_k (B_k - B)(B_k - B)' to the covariance of the chosen lines B; likewise for the bearing of the boundary.
    """
    prefix, boundary_covariance = rays.prefix, segments.boundary_covariance
    middle = sums_up_to(prefix, count, position)
    u0, v0, _ = solve_line(subtract_sums(middle, origin))
    u1, v1, _ = solve_line(subtract_sums(terminus, middle))
    chosen, best = unwrapped_bearing(rays.bearing, count, position), gain_at(gains, count, position)
    total, bearing_variation = 1.0, 0.0
    first, second = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(low, high + 1):
        deficit = best - gain_at(gains, count, k)
        if not deficit < MAX_BOUNDARY_CHI2 or k == position:
            continue
        likelihood = math.exp(-0.5 * deficit)
        total += likelihood
        angle = unwrapped_bearing(rays.bearing, count, k) - chosen
        bearing_variation += likelihood * angle * angle
        middle = sums_up_to(prefix, count, k)
        u, v, _ = solve_line(subtract_sums(middle, origin))
        first = add_squares(first, likelihood, u - u0, v - v0)
        u, v, _ = solve_line(subtract_sums(terminus, middle))
        second = add_squares(second, likelihood, u - u1, v - v1)
    if math.isfinite(first[0] + first[2] + second[0] + second[2]):
        for entry in range(3):
            boundary_covariance[entry, i] += first[entry] / total
            boundary_covariance[entry, j] += second[entry] / total
        boundary_covariance[3, i] = bearing_variation / total


@inlined
def add_squares(squares: tuple[float, float, float], weight: float, du: float, dv: float) -> tuple[float, float, float]:
    """Return weighted sums of du^2, du dv and dv^2 with one more difference (du, dv)."""
    uu, uv, vv = squares
    return uu + weight * du * du, uv + weight * du * dv, vv + weight * dv * dv


@inlined
def gain_at(gains: Floats, count: int, k: int) -> float:
    """Return the gain of a boundary before ray k, which may be in the next revolution."""
    return float(gains[k] if k <= count else gains[k - count])


@inlined
def unwrapped_bearing(bearing: Floats, count: int, k: int) -> float:
    """Return the bearing of ray k, which may be in the next revolution."""
    return float(bearing[k] if k < count else bearing[k - count] + TURN)


@inlined
def move_boundary(prefix: Floats, count: int, segments: Segments, i: int, j: int, position: int, shift: int) -> None:
    """Move the boundary of segments i and j to ray `position`; ray indices of j are `shift` smaller."""
    boundary = segments.end[i]
    moved = sums_over(prefix, count, boundary, position)  # negative if the boundary moves back
    set_column(segments.sums, i, add_sums(get_column(segments.sums, i), moved))
    set_column(segments.sums, j, subtract_sums(get_column(segments.sums, j), moved))
    if segments.head[i] == boundary:
        segments.head[i] = position
    if segments.tail[j] == segments.begin[j]:
        segments.tail[j] = position - shift
    segments.end[i] = position
    segments.begin[j] = position - shift

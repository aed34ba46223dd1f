"""The sums of a line's normal equations: what rays add to them, and in constant time the line that they give.

A table of sums is an array (6, n) with one set of them in each column.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .compiled import compiled
from .types import Floats


class Sums(NamedTuple):
    """W, E, H and K over some rays (see wclm)."""

    weight: float
    er: float
    ei: float
    hr: float
    hi: float
    k: float


@compiled
def no_rays() -> Sums:
    """The sums over no rays at all."""
    return Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@compiled
def at(table: Floats, k: int) -> Sums:
    """Column k of a table."""
    return Sums(table[0, k], table[1, k], table[2, k], table[3, k], table[4, k], table[5, k])


@compiled
def put(table: Floats, k: int, sums: Sums) -> None:
    """Overwrite column k of a table."""
    table[0, k], table[1, k], table[2, k], table[3, k], table[4, k], table[5, k] = sums


@compiled
def plus(a: Sums, b: Sums) -> Sums:
    """Over the rays of both."""
    return Sums(a.weight + b.weight, a.er + b.er, a.ei + b.ei, a.hr + b.hr, a.hi + b.hi, a.k + b.k)


@compiled
def minus(a: Sums, b: Sums) -> Sums:
    """Over the rays of `a` that are not in `b`."""
    return Sums(a.weight - b.weight, a.er - b.er, a.ei - b.ei, a.hr - b.hr, a.hi - b.hi, a.k - b.k)


@compiled
def up_to(prefix: Floats, count: int, k: int) -> Sums:
    """Over the rays 0..k-1 of n = `count`, where k may exceed n (see rays); column k of `prefix` is that for k <= n."""
    return at(prefix, k) if k <= count else plus(at(prefix, count), at(prefix, k - count))


@compiled
def over(prefix: Floats, count: int, begin: int, end: int) -> Sums:
    """Over the rays begin..end-1 of n = `count`; end may exceed n."""
    return minus(up_to(prefix, count, end), up_to(prefix, count, begin))


@compiled
def solve(sums: Sums) -> tuple[float, float, float]:
    """(u, v) of the normal equations, and D = W^2 - |E|^2, four times their determinant; NaN and 0 without a line."""
    weight, er, ei, hr, hi, _ = sums
    determinant = weight * weight - er * er - ei * ei
    if not determinant > 0.0:
        return math.nan, math.nan, 0.0
    scale = 2.0 / determinant
    return scale * ((weight - er) * hr - ei * hi), scale * ((weight + er) * hi - ei * hr), determinant


@compiled
def bearing_variance(sums: Sums) -> float:
    """Variance of the rays' bearings, weighted, where they are within less than a radian of each other."""
    return 0.25 * (1.0 - (sums.er * sums.er + sums.ei * sums.ei) / (sums.weight * sums.weight))


@compiled
def residual_sum(sums: Sums) -> float:
    """Weighted sum of squared residuals at the optimum, K - Re(conj(B) H) with B = u + i v; NaN without one."""
    u, v, _ = solve(sums)
    return max(0.0, sums.k - u * sums.hr - v * sums.hi) if math.isfinite(u) else math.nan

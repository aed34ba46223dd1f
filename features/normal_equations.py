"""Normal equations of a line as six sums over rays, from which the line follows in constant time.

A table of sums is an array (6, n) with one set of sums per column.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .compiled import inlined
from .types import Floats


class Sums(NamedTuple):
    """Sums W, Re E, Im E, Re H, Im H and K over some rays (see wclm)."""

    weight: float
    er: float
    ei: float
    hr: float
    hi: float
    k: float


@inlined
def zero_sums() -> Sums:
    """Return the sums over no rays."""
    return Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def get_column(table: Floats, k: int) -> Sums:
    """Return column k of a table."""
    return Sums(table[0, k], table[1, k], table[2, k], table[3, k], table[4, k], table[5, k])


@inlined
def set_column(table: Floats, k: int, sums: Sums) -> None:
    """Set column k of a table."""
    table[0, k], table[1, k], table[2, k], table[3, k], table[4, k], table[5, k] = sums


@inlined
def add_sums(a: Sums, b: Sums) -> Sums:
    """Return the sums over the rays of both."""
    return Sums(a.weight + b.weight, a.er + b.er, a.ei + b.ei, a.hr + b.hr, a.hi + b.hi, a.k + b.k)


@inlined
def subtract_sums(a: Sums, b: Sums) -> Sums:
    """Return the sums over the rays of `a` that are not in `b`."""
    return Sums(a.weight - b.weight, a.er - b.er, a.ei - b.ei, a.hr - b.hr, a.hi - b.hi, a.k - b.k)


@inlined
def sums_up_to(prefix: Floats, count: int, k: int) -> Sums:
    """Return the sums over the rays 0..k-1; k may exceed n = `count` (see rays).

    Column k of `prefix` has the sums over the rays 0..k-1 for k <= n.
    """
    return get_column(prefix, k) if k <= count else add_sums(get_column(prefix, count), get_column(prefix, k - count))


@inlined
def sums_over(prefix: Floats, count: int, begin: int, end: int) -> Sums:
    """Return the sums over the rays begin..end-1; end may exceed n = `count`."""
    return subtract_sums(sums_up_to(prefix, count, end), sums_up_to(prefix, count, begin))


@inlined
def solve_line(sums: Sums) -> tuple[float, float, float]:
    """Solve the normal equations for (u, v); also return D = W^2 - |E|^2, four times their determinant.

    Returns (NaN, NaN, 0) if no line is determined.
    """
    weight, er, ei, hr, hi, _ = sums
    determinant = weight * weight - er * er - ei * ei
    if not determinant > 0.0:
        return math.nan, math.nan, 0.0
    scale = 2.0 / determinant
    return scale * ((weight - er) * hr - ei * hi), scale * ((weight + er) * hi - ei * hr), determinant


@inlined
def bearing_variance(sums: Sums) -> float:
    """Return the weighted variance of the rays' bearings, valid if they span less than a radian."""
    return 0.25 * (1.0 - (sums.er * sums.er + sums.ei * sums.ei) / (sums.weight * sums.weight))


@inlined
def residual_sum(sums: Sums) -> float:
    """Return the weighted sum of squared residuals of the best line, or NaN if there is none.

    It is K - Re(conj(B) H) with B = u + i v.
    """
    u, v, _ = solve_line(sums)
    return max(0.0, sums.k - u * sums.hr - v * sums.hi) if math.isfinite(u) else math.nan

"""Intervals of rays with the six sums of their lines."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .compiled import compiled
from .sums import Sums, at, plus, put, residual_sum, solve
from .types import Floats, Integers


class Pieces(NamedTuple):
    """Intervals of rays in order, none overlapping; the last may run over ray n (see rays)."""

    begin: Integers
    end: Integers  # one past the last ray
    head: Integers  # end of the first uninterrupted run of rays
    tail: Integers  # begin of the last uninterrupted run
    sums: Floats  # (6, pieces) table of the rays that belong to the piece; bridged rays do not
    spread: Floats  # (4, pieces) variances by where boundaries may lie: uu, uv, vv of the line; bearing of its end


FLOAT_ROWS = 6 + 4 + 1
INTEGER_ROWS = 5


def allocate(beams: int) -> tuple[Floats, Integers]:
    """Memory for scans of up to `beams` beams."""
    return np.zeros((FLOAT_ROWS, beams + 1)), np.zeros((INTEGER_ROWS, 2 * beams + 2), dtype=np.int64)


@compiled
def views(floats: Floats, integers: Integers) -> tuple[Pieces, Floats, Integers]:
    """Pieces in the memory that `allocate` gave, and gains and a stack to split by."""
    pieces = Pieces(integers[0], integers[1], integers[2], integers[3], floats[0:6], floats[6:10])
    return pieces, floats[10], integers[4]


@compiled
def append(pieces: Pieces, made: int, begin: int, end: int) -> int:
    """Add the interval begin..end as one piece; the new number of pieces. Its sums are left to the caller."""
    pieces.begin[made], pieces.end[made] = begin, end
    pieces.head[made], pieces.tail[made] = end, begin
    return made + 1


@compiled
def add(pieces: Pieces, i: int, sums: Sums) -> None:
    """Add rays to piece i."""
    put(pieces.sums, i, plus(at(pieces.sums, i), sums))


@compiled
def cost(pieces: Pieces, i: int) -> float:
    """Chi-square of piece i."""
    return residual_sum(at(pieces.sums, i)) if pieces.end[i] - pieces.begin[i] > 2 else 0.0


@compiled
def line(pieces: Pieces, i: int) -> tuple[float, float]:
    """(u, v) of piece i."""
    u, v, _ = solve(at(pieces.sums, i))
    return u, v


@compiled
def joint_line(pieces: Pieces, i: int, j: int) -> tuple[float, float, float]:
    """(u, v, chi-square) of the one line through pieces i and j."""
    sums = plus(at(pieces.sums, i), at(pieces.sums, j))
    u, v, _ = solve(sums)
    return u, v, residual_sum(sums) if math.isfinite(u) else math.inf


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
    add(pieces, i, at(pieces.sums, j))


@compiled
def copy(pieces: Pieces, source: int, target: int) -> None:
    """Overwrite piece `target` with piece `source`."""
    if source == target:
        return
    pieces.begin[target], pieces.end[target] = pieces.begin[source], pieces.end[source]
    pieces.head[target], pieces.tail[target] = pieces.head[source], pieces.tail[source]
    put(pieces.sums, target, at(pieces.sums, source))
    for row in range(4):
        pieces.spread[row, target] = pieces.spread[row, source]


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

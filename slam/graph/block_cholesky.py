"""Cholesky factorisation of a sparse symmetric matrix of blocks (3, 3), one block row per variable.

The matrix is L L'. Only the blocks of L below the diagonal that are not zero are stored, column by column, in the order
of elimination. The blocks of the inverse at the same places follow from L without computing the others (Takahashi,
Fagan and Chin 1973): those on the diagonal are the marginal covariances of the variables.
"""

from __future__ import annotations

import numpy as np

from drivers.compiled import compiled, inlined

from ..geometry.segments import Floats, Integers
from .block_pattern import Pattern

# A diagonal element that elimination leaves smaller than this share of what it was is zero but for rounding errors.
# Origin: numerical.
MIN_PIVOT_SHARE = 1e-14


def factorise(pattern: Pattern, diagonal: Floats, below: Floats) -> bool:
    """Replace a matrix by L, and return True; False if it is not positive definite.

    diagonal  (n, 3, 3) blocks on the diagonal, symmetric; of L, their inverses
    below     (b, 3, 3) blocks below the diagonal
    """
    return bool(_factorise(pattern.starts, pattern.rows, diagonal, below))


def solve(pattern: Pattern, diagonal: Floats, below: Floats, right: Floats) -> Floats:
    """Return the solution (n, 3) for a right-hand side (n, 3), given L as `factorise` left it."""
    return np.asarray(_solve(pattern.starts, pattern.rows, diagonal, below, right.copy()))


def joint_inverse(pattern: Pattern, diagonal: Floats, below: Floats, ranks: Integers) -> Floats:
    """Return the part (3 k, 3 k) of the inverse in the rows and columns of k variables, by their ranks.

    L is as `factorise` left it. With the columns E of the unit matrix, the part is Y' Y with L Y = E. A column of Y is
    zero but in the rows of what is eliminated after its variable and depends on it.
    """
    return np.asarray(_joint_inverse(pattern.starts, pattern.rows, diagonal, below, ranks))


def inverse_blocks(pattern: Pattern, diagonal: Floats, below: Floats) -> tuple[Floats, Floats]:
    """Return the blocks of the inverse on the diagonal, (n, 3, 3), and at the places of those below it, (b, 3, 3).

    L is as `factorise` left it.
    """
    blocks: tuple[Floats, Floats] = _inverse_blocks(pattern.starts, pattern.rows, diagonal, below)
    return blocks


@inlined
def _copy(target, block):  # type: ignore[no-untyped-def]
    """Copy a block. Assigning it as an array would take some seconds to compile."""
    for r in range(3):
        for c in range(3):
            target[r, c] = block[r, c]


@inlined
def _subtract_product(target, a, b):  # type: ignore[no-untyped-def]
    """Subtract a b' from a block."""
    for r in range(3):
        for c in range(3):
            target[r, c] -= a[r, 0] * b[c, 0] + a[r, 1] * b[c, 1] + a[r, 2] * b[c, 2]


@inlined
def _subtract_products(column, rows, below, begin, end):  # type: ignore[no-untyped-def]
    """Subtract the products of the blocks after `begin` with that block from the rows of a column.

    The elements of that block are read once: as arrays may overlap, they would be read again for each product.
    """
    b = below[begin]
    b00, b01, b02, b10, b11, b12 = b[0, 0], b[0, 1], b[0, 2], b[1, 0], b[1, 1], b[1, 2]
    b20, b21, b22 = b[2, 0], b[2, 1], b[2, 2]
    for p in range(begin + 1, end):
        target, a = column[rows[p]], below[p]
        for r in range(3):
            x, y, z = a[r, 0], a[r, 1], a[r, 2]
            u = target[r, 0] - (x * b00 + y * b01 + z * b02)
            v = target[r, 1] - (x * b10 + y * b11 + z * b12)
            w = target[r, 2] - (x * b20 + y * b21 + z * b22)
            target[r, 0], target[r, 1], target[r, 2] = u, v, w


@compiled
def _factorise(starts, rows, diagonal, below):  # type: ignore[no-untyped-def]
    """Replace the blocks of a matrix by those of L, column by column, as `factorise` says."""
    count = len(diagonal)
    column = np.zeros((count, 3, 3))  # the column that is computed, by rows
    first = np.full(count, -1)  # of each row, the first of the columns whose next block is in it
    following = np.full(count, -1)  # of each column, the next of these
    place = starts[:-1].copy()  # of each column, its next block
    inverse = np.zeros((3, 3))
    for j in range(count):
        pivots = (diagonal[j, 0, 0], diagonal[j, 1, 1], diagonal[j, 2, 2])
        for p in range(starts[j], starts[j + 1]):
            _copy(column[rows[p]], below[p])
        k = first[j]
        while k >= 0:
            next_column = following[k]
            begin, end = place[k], starts[k + 1]
            _subtract_product(diagonal[j], below[begin], below[begin])
            _subtract_products(column, rows, below, begin, end)
            if begin + 1 < end:
                place[k] = begin + 1
                following[k], first[rows[begin + 1]] = first[rows[begin + 1]], k
            k = next_column
        if not _invert_root(diagonal[j], pivots, inverse):
            return False
        _copy(diagonal[j], inverse)
        for p in range(starts[j], starts[j + 1]):
            block = column[rows[p]]
            for r in range(3):
                for c in range(3):
                    below[p, r, c] = (
                        block[r, 0] * inverse[c, 0] + block[r, 1] * inverse[c, 1] + block[r, 2] * inverse[c, 2]
                    )
        if starts[j] < starts[j + 1]:
            following[j], first[rows[starts[j]]] = first[rows[starts[j]]], j
    return True


@inlined
def _invert_root(block, pivots, inverse):  # type: ignore[no-untyped-def]
    """Compute the inverse of the lower Cholesky factor of a block; return False if it is not positive definite."""
    a = block[0, 0]
    if not a > MIN_PIVOT_SHARE * pivots[0]:
        return False
    a = np.sqrt(a)
    b, d = block[1, 0] / a, block[2, 0] / a
    c = block[1, 1] - b * b
    if not c > MIN_PIVOT_SHARE * pivots[1]:
        return False
    c = np.sqrt(c)
    e = (block[2, 1] - d * b) / c
    f = block[2, 2] - d * d - e * e
    if not f > MIN_PIVOT_SHARE * pivots[2]:
        return False
    f = np.sqrt(f)
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = 1.0 / a, 1.0 / c, 1.0 / f
    inverse[1, 0] = -b / (a * c)
    inverse[2, 0] = (b * e / c - d) / (a * f)
    inverse[2, 1] = -e / (c * f)
    return True


@compiled
def _solve(starts, rows, diagonal, below, x):  # type: ignore[no-untyped-def]
    """Solve L L' x = b in place."""
    for j in range(len(diagonal)):
        d, (u, v, w) = diagonal[j], x[j]
        x[j, 0], x[j, 1], x[j, 2] = d[0, 0] * u, d[1, 0] * u + d[1, 1] * v, d[2, 0] * u + d[2, 1] * v + d[2, 2] * w
        for p in range(starts[j], starts[j + 1]):
            for r in range(3):
                x[rows[p], r] -= below[p, r, 0] * x[j, 0] + below[p, r, 1] * x[j, 1] + below[p, r, 2] * x[j, 2]
    for j in range(len(diagonal) - 1, -1, -1):
        for p in range(starts[j], starts[j + 1]):
            for c in range(3):
                other = x[rows[p]]
                x[j, c] -= below[p, 0, c] * other[0] + below[p, 1, c] * other[1] + below[p, 2, c] * other[2]
        d, (u, v, w) = diagonal[j], x[j]
        x[j, 0], x[j, 1], x[j, 2] = d[0, 0] * u + d[1, 0] * v + d[2, 0] * w, d[1, 1] * v + d[2, 1] * w, d[2, 2] * w
    return x


@compiled
def _places_after(starts, rows, count, ranks):  # type: ignore[no-untyped-def]
    """Return the places (count,) of some variables, and of all that depend on their elimination, among these; else -1.

    The variable in the first row of a column is the first one that depends on that of the column.
    """
    places, number = np.full(count, -1), 0
    for rank in ranks:
        j = rank
        while places[j] < 0:
            places[j] = 0
            if starts[j] < starts[j + 1]:
                j = rows[starts[j]]
    for j in range(count):
        if places[j] == 0:
            places[j], number = number, number + 1
    return places, number


@compiled
def _joint_inverse(starts, rows, diagonal, below, ranks):  # type: ignore[no-untyped-def]
    """Return the part of the inverse as `joint_inverse` does."""
    size, (places, number) = 3 * len(ranks), _places_after(starts, rows, len(diagonal), ranks)
    y, joint = np.zeros((number, size, 3)), np.zeros((size, size))  # of `y`, the second axis is that of columns
    for k in range(size):
        y[places[ranks[k // 3]], k, k % 3] = 1.0
    for j in range(len(diagonal)):
        if places[j] < 0:
            continue
        d, own = diagonal[j], y[places[j]]
        for k in range(size):
            u, v, w = own[k, 0], own[k, 1], own[k, 2]
            if u == 0.0 and v == 0.0 and w == 0.0:
                continue
            u, v, w = d[0, 0] * u, d[1, 0] * u + d[1, 1] * v, d[2, 0] * u + d[2, 1] * v + d[2, 2] * w
            own[k, 0], own[k, 1], own[k, 2] = u, v, w
            for p in range(starts[j], starts[j + 1]):
                target, block = y[places[rows[p]], k], below[p]
                for r in range(3):
                    target[r] -= block[r, 0] * u + block[r, 1] * v + block[r, 2] * w
            for m in range(k + 1):
                joint[k, m] += u * own[m, 0] + v * own[m, 1] + w * own[m, 2]
    for k in range(size):
        for m in range(k):
            joint[m, k] = joint[k, m]
    return joint


@inlined
def _add_product(target, a, b):  # type: ignore[no-untyped-def]
    """Add a b to a block."""
    for r in range(3):
        for c in range(3):
            target[r, c] += a[r, 0] * b[0, c] + a[r, 1] * b[1, c] + a[r, 2] * b[2, c]


@inlined
def _add_product_of_transposed(target, a, b):  # type: ignore[no-untyped-def]
    """Add a' b to a block."""
    for r in range(3):
        for c in range(3):
            target[r, c] += a[0, r] * b[0, c] + a[1, r] * b[1, c] + a[2, r] * b[2, c]


@inlined
def _add_products(product, scaled, inverse, rows, begin, end, k, mark, j):  # type: ignore[no-untyped-def]
    """Add the products of the inverse's blocks in the column k, in rows with the mark j, to those of Z l d^-1.

    Elements of the row k are read and written once: as arrays may overlap, they would be for each product.
    """
    s = scaled[k]
    s00, s01, s02, s10, s11, s12 = s[0, 0], s[0, 1], s[0, 2], s[1, 0], s[1, 1], s[1, 2]
    s20, s21, s22 = s[2, 0], s[2, 1], s[2, 2]
    p00 = p01 = p02 = p10 = p11 = p12 = p20 = p21 = p22 = 0.0
    for q in range(begin, end):
        row = rows[q]
        if mark[row] != j:
            continue
        a, target, other = inverse[q], product[row], scaled[row]
        for r in range(3):
            x, y, z = a[r, 0], a[r, 1], a[r, 2]
            u, v, w = other[r, 0], other[r, 1], other[r, 2]
            p00, p01, p02 = p00 + x * u, p01 + x * v, p02 + x * w
            p10, p11, p12 = p10 + y * u, p11 + y * v, p12 + y * w
            p20, p21, p22 = p20 + z * u, p21 + z * v, p22 + z * w
            t0 = target[r, 0] + x * s00 + y * s10 + z * s20
            t1 = target[r, 1] + x * s01 + y * s11 + z * s21
            t2 = target[r, 2] + x * s02 + y * s12 + z * s22
            target[r, 0], target[r, 1], target[r, 2] = t0, t1, t2
    own = product[k]
    own[0, 0], own[0, 1], own[0, 2] = own[0, 0] + p00, own[0, 1] + p01, own[0, 2] + p02
    own[1, 0], own[1, 1], own[1, 2] = own[1, 0] + p10, own[1, 1] + p11, own[1, 2] + p12
    own[2, 0], own[2, 1], own[2, 2] = own[2, 0] + p20, own[2, 1] + p21, own[2, 2] + p22


@compiled
def _inverse_blocks(starts, rows, diagonal, below):  # type: ignore[no-untyped-def]
    """Return the blocks of the inverse on the diagonal and below it; see `inverse_blocks`.

    With the column l of L below the diagonal, d on it, and Z the part of the inverse in the rows and columns of l, the
    blocks of the inverse in this column are -Z l d^-1, and d^-T (1 + l' Z l) d^-1 on the diagonal.
    """
    count = len(diagonal)
    on_diagonal, inverse = np.zeros((count, 3, 3)), np.zeros((len(rows), 3, 3))
    scaled, product = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))  # l d^-1 and Z l d^-1, by rows
    mark = np.full(count, -1)
    for j in range(count - 1, -1, -1):
        column = rows[starts[j] : starts[j + 1]]
        for p, k in enumerate(column):
            mark[k] = j
            scaled[k], product[k] = 0.0, 0.0
            _add_product(scaled[k], below[starts[j] + p], diagonal[j])
        for k in column:
            _add_product(product[k], on_diagonal[k], scaled[k])
            _add_products(product, scaled, inverse, rows, starts[k], starts[k + 1], k, mark, j)
        _add_product_of_transposed(on_diagonal[j], diagonal[j], diagonal[j])
        for p, k in enumerate(column):
            for r in range(3):
                for c in range(3):
                    inverse[starts[j] + p, r, c] = -product[k, r, c]
            _add_product_of_transposed(on_diagonal[j], scaled[k], product[k])
    return on_diagonal, inverse

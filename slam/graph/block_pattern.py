"""Where the blocks of a sparse Cholesky factor are that are not zero, found before it is computed."""

from __future__ import annotations

import gtsam
import numpy as np

from drivers.compiled import compiled
from drivers.immutable import immutable

from ..geometry.segments import Integers


@immutable
class Pattern:
    """Where the blocks of L are, of a matrix L L'. Variables are numbered in the order of elimination.

    rank    (n,) of each variable in this order
    starts  (n + 1,) first block below the diagonal of each column
    rows    (b,) row of each such block, ascending in each column
    slots   (m,) of each given pair of variables, its block in the column of the one that is eliminated first
    """

    rank: Integers
    starts: Integers
    rows: Integers
    slots: Integers

    @classmethod
    def of_pairs(cls, count: int, pairs: Integers, rank: Integers | None = None) -> Pattern:
        """Find the blocks of L for `count` variables, given the pairs (m, 2) whose blocks are not zero.

        rank  (count,) of each variable in the order of elimination; None to find one with little fill-in
        """
        if rank is None:
            rank = _ranks(count, np.column_stack(np.divmod(_distinct(_places(count, pairs)), count)))
        given = _places(count, rank[pairs])
        starts, rows = _fill_in(count, *np.divmod(_distinct(given), count))
        places = np.sort(np.repeat(np.arange(count), np.diff(starts)) * count + rows)
        return cls(rank, starts, places % count, np.searchsorted(places, given))


def _places(count: int, pairs: Integers) -> Integers:
    """Return the place (m,) of each pair of variables in the matrix, counted column by column, below the diagonal."""
    return np.minimum(pairs[:, 0], pairs[:, 1]) * count + np.maximum(pairs[:, 0], pairs[:, 1])


def _distinct(numbers: Integers) -> Integers:
    """Return distinct numbers in ascending order, in a quarter of the time of `np.unique`, which hashes them."""
    ordered = np.sort(numbers)
    return ordered[np.diff(ordered, prepend=-1) > 0]


def _ranks(count: int, pairs: Integers) -> Integers:
    """Return the place (count,) of each variable in an order with little fill-in (COLAMD), given distinct pairs."""
    graph = gtsam.SymbolicFactorGraph()
    for variable in range(count):
        graph.push_factor(variable)
    for one, other in pairs.tolist():
        graph.push_factor(one, other)
    order = gtsam.Ordering.ColamdSymbolicFactorGraph(graph)
    ranks = np.empty(count, dtype=np.int64)
    ranks[[order.at(place) for place in range(count)]] = np.arange(count)
    return ranks


@compiled
def _fill_in(count, columns, rows):  # type: ignore[no-untyped-def]
    """Return starts and unsorted rows of L, given the places of the matrix's blocks below the diagonal by column.

    The rows of column j are the rows of the matrix in this column, and the rows of all columns whose first row is j.
    """
    children = np.full(count, -1)  # of each column, the last column whose first row it is
    sibling = np.full(count, -1)  # of each column, the next one with the same first row
    mark = np.full(count, -1)
    starts = np.zeros(count + 1, np.int64)
    found = np.empty(4 * len(rows) + count, np.int64)
    given = 0
    for j in range(count):
        begin = end = starts[j]
        if end + count > len(found):
            found = np.concatenate((found, np.empty(len(found) + count, np.int64)))
        mark[j] = j
        while given < len(rows) and columns[given] == j:
            mark[rows[given]] = j
            found[end] = rows[given]
            given, end = given + 1, end + 1
        child = children[j]
        while child >= 0:
            for p in range(starts[child], starts[child + 1]):
                if mark[found[p]] != j:
                    mark[found[p]] = j
                    found[end] = found[p]
                    end += 1
            child = sibling[child]
        starts[j + 1] = end
        if end > begin:
            parent = count
            for p in range(begin, end):
                parent = min(parent, found[p])
            sibling[j], children[parent] = children[parent], j
    return starts, found[: starts[count]].copy()

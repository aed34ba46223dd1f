"""The graph of iSAM2 as a batch solution, which follows its updates.

iSAM2 computes the joint covariance of variables in a time that depends on where they are in its tree: it is short for
the variables of the last metres, and a tenth of a second for a pose of the last keyframe and one of another pass. To
factorise the whole graph takes less than that, and then any covariance takes a millisecond.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice

import gtsam
import numpy as np

from ..geometry.membership import is_among
from ..geometry.segments import Integers
from .array_graph import ArrayGraph
from .batch_solution import BatchSolution
from .factors import Factor


class PresentSolution:
    """Arrays of the factors of a graph, and the batch solution of it since the last update."""

    def __init__(self) -> None:
        self._arrays: ArrayGraph | None = None  # of the factors when they were needed last
        self._numbers: Integers = np.zeros(0, dtype=np.int64)  # of these factors, ascending
        self._solution: BatchSolution | None = None

    def copy(self) -> PresentSolution:
        """Return an independent copy."""
        other = PresentSolution()
        other._arrays, other._numbers, other._solution = self._arrays, self._numbers, self._solution
        return other

    def outdate(self) -> None:
        """Forget the solution, as factors are added or removed."""
        self._solution = None

    def forget(self) -> None:
        """Forget the arrays as well, as the factors are numbered again."""
        self._solution = self._arrays = None

    def arrays(self, factors: dict[int, Factor], bias: float) -> ArrayGraph:
        """Return all factors as arrays, given those of the graph by ascending numbers, and the range bias (metres)."""
        numbers = np.fromiter(factors, dtype=np.int64, count=len(factors))
        if self._arrays is None:
            self._arrays = ArrayGraph([*factors.values()], bias)
        else:
            removed = np.flatnonzero(~is_among(self._numbers, numbers))
            new = [*islice(factors.values(), len(self._numbers) - len(removed), None)]
            self._arrays = self._arrays.with_factors(removed, new).at_bias(bias)
        self._numbers = numbers
        return self._arrays

    def solution(
        self, factors: dict[int, Factor], bias: float, linearised: Callable[[], gtsam.Values]
    ) -> BatchSolution:
        """Return the batch solution, linearised where `linearised` returns; for the other arguments see `arrays`."""
        if self._solution is None or self._solution.bias != bias:
            arrays = self.arrays(factors, bias)
            self._solution = BatchSolution(arrays, arrays.values_of(linearised()), bias)
        return self._solution

"""A whole graph as arrays: Gauss-Newton steps, the robust cost and marginal covariances in a few compiled calls.

The incremental solver holds each factor as an object of GTSAM, of which some ten thousand take a second to build and to
linearise. At the end of a run the graph is linearised some dozens of times. The errors, their Jacobians, the robust
weights and the retraction of poses are those of GTSAM, so that both have the same optimum and the same covariances.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cached_property

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C
from numpy.typing import NDArray

from ..errors import MapError
from ..geometry.segments import Floats, Integers
from .array_factors import BETWEEN, POINT, PRIOR, add_normal_equations, moved, robust_cost, squared_distances
from .block_cholesky import factorise, inverse_blocks, joint_inverse, solve
from .block_pattern import Pattern
from .factors import CAUCHY_SCALES, KEY_INDEX_BITS, PRIOR_KINDS, WALL_KINDS, Factor, FactorKind, FactorsOfKind, by_kind

# Growth of a graph, in variables, up to which an order of elimination is continued. Origin: measured, after it L has a
# half more blocks than by a new order, and to find that takes as long as the rest of a solution.
MAX_GROWTH = 1.1
# Names of the arrays with a row for each factor, besides its ends. Origin: definition.
_BY_FACTOR = ("_form", "_measured", "_direction", "_information", "_scale")


class LinearGraph:
    """A linearised graph, factorised."""

    def __init__(self, pattern: Pattern, diagonal: Floats, below: Floats, gradient: Floats) -> None:
        self._pattern, self._diagonal, self._below, self._gradient = pattern, diagonal, below, gradient

    @cached_property
    def step(self) -> Floats:
        """Gauss-Newton step (n, 3) in the variables' tangent spaces; a covariance does not need it."""
        return np.asarray(solve(self._pattern, self._diagonal, self._below, self._gradient)[self._pattern.rank])

    def covariances(self) -> Floats:
        """Return the marginal covariance (n, 3, 3) of each variable in its own tangent space."""
        return inverse_blocks(self._pattern, self._diagonal, self._below)[0][self._pattern.rank]

    def joint_covariance(self, rows: Integers) -> Floats:
        """Return the joint covariance (3 k, 3 k) of k variables, with three components of each."""
        return joint_inverse(self._pattern, self._diagonal, self._below, self._pattern.rank[rows])


class _Elimination:
    """The order of elimination, found when it is needed first: residuals and costs do not need it.

    Graphs with the same variables and groups share it.
    """

    def __init__(self, variables: int, ends: Integers, relative: NDArray[np.bool_], groups: Sequence[Integers]) -> None:
        """Create an elimination without an order.

        variables  number of variables
        ends       (f, 2) rows of the variables of each factor
        relative   (f,) true for factors of two different variables
        groups     rows of the variables of each group whose joint covariance is wanted
        """
        self._variables, self._ends, self._relative, self._groups = variables, ends, relative, groups
        self._rank: Integers | None = None  # None to find an order
        self._found_for = variables  # their number when the order was found

    def follow(self, earlier: _Elimination, rows: Integers) -> None:
        """Use the order of an earlier graph for its variables, and eliminate new variables after them.

        New variables come last whatever they are connected with, so that L fills: a new order is found if the graph has
        grown by more than MAX_GROWTH since the last one was. `rows` (v,) are those of the earlier variables.
        """
        if "pattern" not in earlier.__dict__ or self._variables > MAX_GROWTH * earlier._found_for:
            return
        self._rank, self._found_for = np.full(self._variables, -1), earlier._found_for
        self._rank[rows] = earlier.pattern.rank
        self._rank[self._rank < 0] = np.arange(len(rows), self._variables)

    @cached_property
    def pattern(self) -> Pattern:
        """Order of elimination, and the blocks that are not zero: first the factors' blocks, then the groups'."""
        pairs = [np.stack(np.triu_indices(len(rows), 1), axis=1) for rows in self._groups]
        joint = [rows[pair] for rows, pair in zip(self._groups, pairs, strict=True)]
        return Pattern.of_pairs(self._variables, np.concatenate([self._ends[self._relative], *joint]), self._rank)

    @cached_property
    def slots(self) -> Integers:
        """(f,) block of each factor of two variables; see `Pattern`."""
        slots = np.zeros(len(self._ends), dtype=np.int64)
        slots[self._relative] = self.pattern.slots[: self._relative.sum()]
        return slots


class ArrayGraph:
    """Factors of a graph as arrays.

    keys     of the n variables, ascending
    corners  (n,) true for corners, whose third component is always zero
    """

    def __init__(self, factors: Sequence[Factor], bias: float) -> None:
        """Convert factors; `bias` is the range bias (metres) without which the noise of corners is converted."""
        self._form = np.full(len(factors), BETWEEN)
        self._measured, self._direction = np.zeros((len(factors), 3)), np.zeros((len(factors), 3))
        self._information, self._scale = np.zeros((len(factors), 3, 3)), np.full(len(factors), np.inf)
        self._corner_factors: FactorsOfKind | None = None
        ends = np.zeros((len(factors), 2), dtype=np.uint64)
        for group in by_kind(factors):
            ends[group.rows] = group.keys
            self._convert(group)
        self._bias = bias
        self._set_variables(ends)
        self._set_noise_of_corners()
        self._set_groups(())

    def __len__(self) -> int:
        """Number of factors."""
        return len(self._form)

    def with_factors(self, removed: Integers, new: Sequence[Factor]) -> ArrayGraph:
        """Return the graph without the factors in some rows, and with new ones after the others."""
        graph = self._without(removed) if len(removed) else self
        return graph._with(ArrayGraph(new, self._bias)) if len(new) else graph

    def _without(self, removed: Integers) -> ArrayGraph:
        """Return the graph without the factors in some rows, and without variables that have none then."""
        kept, other = np.ones(len(self._form), dtype=bool), copy(self)
        kept[removed] = False
        for name in _BY_FACTOR:
            setattr(other, name, getattr(self, name)[kept])
        if self._corner_factors is not None:
            other._corner_factors = self._corner_factors.where(kept)
        other._set_variables(np.array(self.keys, dtype=np.uint64)[self._ends[kept]])
        other._set_groups(())
        return other

    def _with(self, added: ArrayGraph) -> ArrayGraph:
        """Return the graph with the factors of another one after its own. It continues the order of elimination."""
        other = copy(self)
        for name in _BY_FACTOR:
            setattr(other, name, np.concatenate([getattr(self, name), getattr(added, name)]))
        if added._corner_factors is not None:
            other._corner_factors = added._corner_factors.after(self._corner_factors, len(self))
        known, new = (np.array(graph.keys, dtype=np.uint64) for graph in (self, added))
        keys = np.union1d(known, new)
        rows, new_rows = np.searchsorted(keys, known), np.searchsorted(keys, new)
        other.keys = keys.tolist()
        other._ends = np.concatenate([rows[self._ends], new_rows[added._ends]])
        other.corners = np.zeros(len(keys), dtype=bool)
        other.corners[rows], other.corners[new_rows] = self.corners, added.corners
        other._set_groups(())
        other._elimination.follow(self._elimination, rows)
        return other

    def with_divided_information(self, divisors: Floats) -> ArrayGraph:
        """Return the graph with the information of each factor, except of corners, divided by a number (f,)."""
        other = copy(self)
        other._information = self._information / divisors[:, None, None]
        return other

    def at_bias(self, bias: float) -> ArrayGraph:
        """Return the graph with the noise of corners as without another range bias (metres)."""
        if bias == self._bias:
            return self
        other = copy(self)
        other._information, other._bias = self._information.copy(), bias
        other._set_noise_of_corners()
        return other

    def with_groups(self, groups: Sequence[Sequence[int]]) -> ArrayGraph:
        """Return the graph with other groups of variables whose joint covariances are wanted."""
        other = copy(self)
        other._set_groups(groups)
        other._elimination.follow(self._elimination, np.arange(len(self.keys)))
        return other

    def _set_variables(self, ends: NDArray[np.uint64]) -> None:
        """Number the variables, given the keys (f, 2) of those of each factor."""
        keys, index = np.unique(ends, return_inverse=True)
        self.keys: list[int] = keys.tolist()
        self._ends = index.reshape(-1, 2)
        self.corners = np.zeros(len(keys), dtype=bool)
        self.corners[self._ends[self._form == POINT, 1]] = True

    def _set_noise_of_corners(self) -> None:
        if (group := self._corner_factors) is not None:
            self._information[group.rows, :2, :2] = np.linalg.inv(group.covariances_in_polar(self._bias))

    def _set_groups(self, groups: Sequence[Sequence[int]]) -> None:
        keys = np.array(self.keys, dtype=np.uint64)
        self._groups = [np.searchsorted(keys, np.array(group, dtype=np.uint64)) for group in groups]
        self._elimination = _Elimination(len(keys), self._ends, self._form != PRIOR, self._groups)

    @property
    def _pattern(self) -> Pattern:
        return self._elimination.pattern

    def _convert(self, group: FactorsOfKind) -> None:
        """Fill in the rows of the factors of one kind; what they measure is described in FactorKind.

        The noise of corners is left out.
        """
        kind, rows, size = group.kind, group.rows, 2 if group.kind is FactorKind.CORNER else 3
        self._measured[rows, :size] = group.measured[:, :size]
        self._direction[rows, :size] = group.bias_directions()[:, :size]
        self._scale[rows] = CAUCHY_SCALES.get(kind, np.inf)
        self._form[rows] = POINT if kind is FactorKind.CORNER else PRIOR if kind in PRIOR_KINDS else BETWEEN
        match kind:
            case FactorKind.CORNER:
                self._corner_factors = group
            case _ if kind in WALL_KINDS:
                root = group.roots_of_information()
                self._information[rows] = root.transpose(0, 2, 1) @ root
            case _:
                self._information[rows] = np.linalg.inv(group.covariances)

    def values_of(self, values: gtsam.Values) -> Floats:
        """Return the variables as an array (n, 3): poses and frames [x, y, heading], corners [x, y, 0].

        There may be more variables among the values.
        """
        keys = np.array(values.keys(), dtype=np.uint64)
        corners = keys >> np.uint64(KEY_INDEX_BITS) == C(0) >> KEY_INDEX_BITS
        result = np.zeros((len(keys), 3))
        result[corners, :2] = gtsam.utilities.extractPoint2(values)
        result[~corners] = gtsam.utilities.extractPose2(values)  # both in the order of the keys
        return result[np.searchsorted(keys, np.array(self.keys, dtype=np.uint64))]

    def to_values(self, values: Floats) -> gtsam.Values:
        """Return the variables (n, 3) as GTSAM's."""
        result = gtsam.Values()
        for key, is_corner, (x, y, heading) in zip(self.keys, self.corners.tolist(), values.tolist(), strict=True):
            if is_corner:
                result.insert(key, np.array([x, y]))
            else:
                result.insert(key, gtsam.Pose2(x, y, heading))
        return result

    @property
    def depends_on_bias(self) -> bool:
        """True if any measurement depends on the range bias."""
        return bool(self._direction.any())

    def by_key(self, of_variables: Floats) -> dict[int, Floats]:
        """Return vectors (n, 3), or matrices (n, 3, 3), by the keys of their variables; corners have two components."""
        axes = of_variables.ndim - 1
        sizes = np.where(self.corners, 2, 3).tolist()
        return {key: one[(slice(size),) * axes] for key, size, one in zip(self.keys, sizes, of_variables, strict=True)}

    def step(self, values: Floats, bias: float) -> Floats:
        """Return the Gauss-Newton step (n, 3) from some values, in the variables' tangent spaces.

        Raises MapError if it is not determined.
        """
        return self.linearise(values, bias).step

    def linearise(self, values: Floats, bias: float) -> LinearGraph:
        """Linearise the graph at some values (n, 3). Raises MapError if the step from there is not determined."""
        return LinearGraph(self._pattern, *self._factorised(values, bias))

    def retract(self, values: Floats, step: Floats) -> Floats:
        """Return values (n, 3) moved by a step (n, 3) in the tangent spaces of the variables."""
        return np.asarray(moved(values, step, self.corners))

    def cost(self, values: Floats, bias: float) -> float:
        """Return twice the robust cost at some values (n, 3)."""
        return float(robust_cost(*self._arrays(bias), values))

    def squared_distances(self, values: Floats, bias: float) -> Floats:
        """Return the squared Mahalanobis distance (f,) of each factor at some values (n, 3), without robust kernels."""
        forms, ends, measured, information, _ = self._arrays(bias)
        return np.asarray(squared_distances(forms, ends, measured, information, values))

    def joint_covariances(self, values: Floats, bias: float) -> list[Floats]:
        """Return the joint covariance (3 k, 3 k) of each group of k variables, with three components of each.

        Raises MapError if they are not determined.
        """
        diagonal, below, _ = self._factorised(values, bias)
        on_diagonal, off_diagonal = inverse_blocks(self._pattern, diagonal, below)
        result, slot = [], int((self._form != PRIOR).sum())
        for rows in self._groups:
            ranks = self._pattern.rank[rows]
            blocks = np.zeros((len(rows), len(rows), 3, 3))
            blocks[np.arange(len(rows)), np.arange(len(rows))] = on_diagonal[ranks]
            first, second = np.triu_indices(len(rows), 1)
            later = np.where(ranks[first] > ranks[second], first, second)
            earlier = first + second - later
            between = off_diagonal[self._pattern.slots[slot : slot + len(first)]]
            blocks[later, earlier], blocks[earlier, later] = between, between.transpose(0, 2, 1)
            result.append(blocks.transpose(0, 2, 1, 3).reshape(3 * len(rows), 3 * len(rows)))
            slot += len(first)
        return result

    def _arrays(self, bias: float) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, Floats, Floats]:
        """Return forms, ends, measurements without a range bias, information and scale of the kernels."""
        measured = self._measured - bias * self._direction
        points = self._form == POINT
        x, y = measured[points, 0], measured[points, 1]
        measured[points, 0], measured[points, 1] = np.arctan2(y, x), np.hypot(x, y)
        return self._form, self._ends, measured, self._information, self._scale

    def _factorised(self, values: Floats, bias: float) -> tuple[Floats, Floats, Floats]:
        """Return the Cholesky factor of the normal equations, and their right side, in the order of elimination."""
        rank = self._pattern.rank
        diagonal, below = np.zeros((len(rank), 3, 3)), np.zeros((len(self._pattern.rows), 3, 3))
        diagonal[rank[self.corners], 2, 2] = 1.0
        gradient = np.zeros((len(rank), 3))
        add_normal_equations(*self._arrays(bias), values, rank, self._elimination.slots, diagonal, below, gradient)
        if not factorise(self._pattern, diagonal, below):
            raise MapError("the map cannot be estimated: it is not determined by the measurements")
        return diagonal, below, gradient

"""Covariance of correlated drift in a finished map, with what loops and observations of old walls say about it.

The correlated drift D(k), the error of the position of keyframe k that its neighbours share, is a random walk along
the drive: it grows from the keyframe that odometry leads from, so keyframes form a tree. With the covariance V(k)
accumulated up to each keyframe, cov(D(i), D(j)) = V(a), a the last common ancestor of both.

A loop, a scan match or submap match, or an observation of a wall that was first seen at keyframe o says that D(k) and
D(o) are equal in some direction n, with the variance r. A pin or a plan says the same of D(k) and the first keyframe,
where the drift is zero. The drift given m of these,

    h = n . (D(k) - D(o)) = 0 +- r,

has the covariance C - C H' (H C H' + R)^-1 H C.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from ..graph.factors import MATCH_KINDS, Factor, FactorKind, FactorsOfKind, by_kind

if TYPE_CHECKING:
    from .mapper import Mapper

# Conditions at most, evenly chosen of those that say anything; the time grows with the square of the number. Conditions
# between the same places say the same. Origin: numerical.
MAX_CONDITIONS = 150
# Share of the largest variance of the drift below which that of a condition is lost in rounding. Origin: numerical, a
# thousand units of double precision, for sums over MAX_CONDITIONS.
ROUNDING = 1e-12
# Kinds of factors that state the place of a wall across it. Origin: definition.
WALL_CONDITIONS = FactorKind.WALL_OFFSET, FactorKind.PLAN_WALL, FactorKind.PINNED_WALL
# Kinds of factors that state the pose of a keyframe, relative to another one or in the map. Origin: definition.
POSE_CONDITIONS = FactorKind.LOOP, *MATCH_KINDS, FactorKind.PINNED_POSE


@immutable
class _Conditions:
    """Keyframes `old` and `new` (m,) with the same drift along the unit vectors `direction` (m, 2).

    variance  (m,) of the difference, square metres
    """

    old: Integers
    new: Integers
    direction: Floats
    variance: Floats

    def __getitem__(self, rows: Integers) -> _Conditions:
        return _Conditions(self.old[rows], self.new[rows], self.direction[rows], self.variance[rows])


def odometry_tree(factors: Iterable[Factor], keyframes: int) -> Integers:
    """Return (k,) the keyframe from which odometry leads to each of k keyframes, -1 for the first one.

    Where the map has a part that is not connected, it is the keyframe before.
    """
    parents: Integers = np.arange(keyframes) - 1
    for factor in factors:
        if factor.kind is FactorKind.ODOMETRY:
            parents[factor.second] = factor.first
    return parents


class DriftCovariance:
    """Covariance of the correlated drift of a settled map's keyframes, (2, 2) in the map's axes, square metres."""

    def __init__(self, mapper: Mapper) -> None:
        self._variances = mapper.correlated_drift
        self._parent = odometry_tree(mapper.graph.solver.factors.values(), mapper.keyframe_count)
        branches = self._parent != np.arange(mapper.keyframe_count) - 1
        self._first = np.maximum.accumulate(np.where(branches, np.arange(mapper.keyframe_count), 0))
        conditions = self._chosen(_conditions_of(mapper))
        self._conditions = conditions
        rounding = ROUNDING * self._variances.max(initial=0.0)
        variance = np.maximum(conditions.variance, rounding)
        covariance = self._of_conditions(conditions, conditions) + np.diag(variance)
        # turns the conditions into independent ones with variance 1
        self._whitening = np.linalg.inv(np.linalg.cholesky(covariance)) if len(covariance) else None

    def between(self, first: Integers, second: Integers) -> Floats:
        """Return (n, 2, 2) the covariances of the drift of the keyframes `first` (n,) with that of `second` (n,)."""
        prior = self._prior(first, second)
        if self._whitening is None:
            return prior
        keyframes, rows = np.unique(np.concatenate([first, second]), return_inverse=True)
        known = self._with_conditions(keyframes) @ self._whitening.T  # (q, 2, m)
        of_first, of_second = known[rows[: len(first)]], known[rows[len(first) :]]
        return np.asarray(prior - of_first @ of_second.transpose(0, 2, 1))

    def of(self, keyframes: Integers) -> Floats:
        """Return (n, 2, 2) the covariances of the drift of keyframes (n,)."""
        return self.between(keyframes, keyframes)

    def _prior(self, first: Integers, second: Integers) -> Floats:
        """Return (..., 2, 2) the covariances without any condition."""
        return np.asarray(self._variances[self._common_ancestors(first, second)])

    def _common_ancestors(self, first: Integers, second: Integers) -> Integers:
        """Return (...) the last common ancestors of keyframes."""
        first, second = (np.array(one) for one in np.broadcast_arrays(first, second))
        while True:
            high, low = np.maximum(first, second), np.minimum(first, second)
            found = self._first[high] <= low  # the way from `high` back to `low` has no branch
            if found.all():
                return low
            first, second = np.where(found, low, self._parent[self._first[high]]), low

    def _with_conditions(self, keyframes: Integers) -> Floats:
        """Return (n, 2, m) the covariances of the drift of keyframes (n,) with the conditions."""
        chosen = self._conditions
        difference = self._prior(keyframes[:, None], chosen.new) - self._prior(keyframes[:, None], chosen.old)
        return np.asarray(np.einsum("kmij,mj->kim", difference, chosen.direction))

    def _of_conditions(self, first: _Conditions, second: _Conditions) -> Floats:
        """Return (m, p) the covariances of the differences of drift in conditions."""
        result = np.zeros((len(first.old), len(second.old)))
        for sign, one, other in (
            (1.0, first.new, second.new),
            (-1.0, first.new, second.old),
            (-1.0, first.old, second.new),
            (1.0, first.old, second.old),
        ):
            blocks = self._prior(one[:, None], other)
            result += sign * np.einsum("mi,mpij,pj->mp", first.direction, blocks, second.direction)
        return result

    def _chosen(self, conditions: _Conditions) -> _Conditions:
        """Return the conditions that say more than is known anyway, at most MAX_CONDITIONS."""
        between = self._prior(conditions.old, conditions.new)
        growth = (
            self._prior(conditions.new, conditions.new) + self._prior(conditions.old, conditions.old) - 2.0 * between
        )
        expected = np.einsum("mi,mij,mj->m", conditions.direction, growth, conditions.direction)
        rows = np.flatnonzero(expected > conditions.variance)
        if len(rows) > MAX_CONDITIONS:
            rows = rows[np.linspace(0, len(rows) - 1, MAX_CONDITIONS).astype(np.int64)]
        return conditions[rows]


def _conditions_of(mapper: Mapper) -> _Conditions:
    """Return all conditions in the graph of a map, in the order of the factors."""
    parts = [_conditions_of_kind(mapper, group) for group in by_kind(_conditional_factors(mapper))]
    none = np.zeros(0, dtype=np.int64)
    conditions = [_Conditions(none, none, np.zeros((0, 2)), np.zeros(0)), *(one for _, one in parts)]
    joined = _Conditions(
        np.concatenate([one.old for one in conditions]),
        np.concatenate([one.new for one in conditions]),
        np.concatenate([one.direction for one in conditions]),
        np.concatenate([one.variance for one in conditions]),
    )
    return joined[np.argsort(np.concatenate([none, *(rows for rows, _ in parts)]), kind="stable")]


def _conditional_factors(mapper: Mapper) -> list[Factor]:
    """Return the factors that state conditions."""
    factors = mapper.graph.solver.factors.values()
    return [factor for factor in factors if factor.kind in WALL_CONDITIONS + POSE_CONDITIONS]


def _conditions_of_kind(mapper: Mapper, group: FactorsOfKind) -> tuple[Integers, _Conditions]:
    """Return the conditions of factors of one kind, and the row of the factor of each."""
    first, second = group.numbers.T
    if group.kind in WALL_CONDITIONS:
        walls = mapper.landmarks.walls.rows
        heading, seen = walls["frame"][second, 2], walls["first_seen"][walls["merged_into"][second]]
        direction = np.column_stack([-np.sin(heading), np.cos(heading)])
        of_observer = group.kind is FactorKind.WALL_OFFSET
        old, new = (seen, first) if of_observer else (np.zeros_like(seen), seen)
        return group.rows, _Conditions(old, new, direction, group.covariances[:, 0, 0])
    variances, axes = np.linalg.eigh(group.covariances[:, :2, :2])
    heading = np.repeat(mapper.keyframe_poses[second, 2], 2)
    direction = se2.transform(
        np.column_stack([np.zeros((len(heading), 2)), heading]), axes.transpose(0, 2, 1).reshape(-1, 2)
    )
    old = np.zeros_like(first) if group.kind is FactorKind.PINNED_POSE else first
    return np.repeat(group.rows, 2), _Conditions(np.repeat(old, 2), np.repeat(second, 2), direction, variances.ravel())

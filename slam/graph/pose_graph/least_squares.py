"""chi2 of a pose graph, sum of e' Omega e, and the normal equations of a Gauss-Newton step.

The variables are x, y, heading of each pose and x, y of each landmark, changed by addition.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csc_array, eye_array
from scipy.sparse.linalg import SuperLU, splu

from drivers.se2 import wrap

from .errors import bearing_errors, motion_errors, position_errors
from .model import Flags, Floats, Integers, PoseGraph

# the matrices are symmetric and positive definite: elimination needs no pivoting
CHOLESKY_LIKE = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


def variables_of(graph: PoseGraph) -> Floats:
    """(3 n + 2 m,): the estimate as one vector, poses first."""
    return np.concatenate([graph.poses.ravel(), graph.landmarks.ravel()])


def with_variables(graph: PoseGraph, x: Floats) -> PoseGraph:
    """The graph with its estimate from a vector as `variables_of` makes it; headings in [-pi, pi)."""
    poses = x[: graph.poses.size].reshape(-1, 3).copy()
    poses[:, 2] = wrap(poses[:, 2])
    return graph.with_estimate(poses, x[graph.poses.size :].reshape(-1, 2).copy())


@dataclass(frozen=True, slots=True, eq=False)
class _Term:
    """The edges of one kind: how their errors are found, and the indices (k, v) of the variables they touch."""

    errors: Callable[[Floats, Floats], tuple[Floats, Floats]]
    measured: Floats
    information: Floats
    touched: Integers


def _terms(graph: PoseGraph) -> tuple[_Term, _Term, _Term]:
    pose, point, first = np.arange(3), np.arange(2), graph.poses.size
    motions, positions, bearings = graph.kinds
    to_poses = np.hstack([3 * motions.source[:, None] + pose, 3 * motions.target[:, None] + pose])
    to_landmarks = [
        np.hstack([3 * edges.source[:, None] + pose, first + 2 * edges.target[:, None] + point])
        for edges in (positions, bearings)
    ]
    return (
        _Term(motion_errors, motions.measured, motions.information, to_poses),
        _Term(position_errors, positions.measured, positions.information, to_landmarks[0]),
        _Term(bearing_errors, bearings.measured, bearings.information, to_landmarks[1]),
    )


def edge_errors(graph: PoseGraph, x: Floats) -> list[Floats]:
    """The errors of the edges at the variables `x`, (k, d) for each kind."""
    return [term.errors(x[term.touched], term.measured)[0] for term in _terms(graph)]


def edge_chi2(graph: PoseGraph, x: Floats) -> Floats:
    """(edge_count,): the chi2 of each edge at the variables `x`."""
    return np.concatenate(
        [
            np.einsum("ki,kij,kj->k", error, edges.information, error)
            for error, edges in zip(edge_errors(graph, x), graph.kinds, strict=True)
        ]
    )


class NormalEquations:
    """J' W Omega J and J' W Omega e of a graph over the variables that are `free` (3 n + 2 m,) to move.

    The pattern of the matrix and the order of elimination are found once, for all steps.
    """

    def __init__(self, graph: PoseGraph, free: Flags) -> None:
        self._terms = _terms(graph)
        self._order = _elimination_order(graph, free)
        self.size = len(self._order)
        self._place = np.full(len(free), -1, dtype=np.int64)
        self._place[self._order] = np.arange(self.size)
        self._places = [self._place[term.touched] for term in self._terms]
        self._lay_out()

    def _lay_out(self) -> None:
        """Find where, in the matrix's compressed columns, each number of each edge's block is to be added."""
        keys = [
            np.where((p[:, :, None] < 0) | (p[:, None, :] < 0), -1, p[:, :, None] * self.size + p[:, None, :]).ravel()
            for p in self._places
        ]
        diagonal = np.arange(self.size) * (self.size + 1)
        entries, slots = np.unique(np.concatenate([[-1], diagonal, *keys]), return_inverse=True)
        self._diagonal = slots[1 : self.size + 1] - 1  # entry 0 takes what concerns fixed variables
        self._slots = slots[self.size + 1 :]
        columns, self._rows = np.divmod(entries[1:], max(self.size, 1))
        self._starts = np.searchsorted(columns, np.arange(self.size + 1))

    def at(self, x: Floats, weights: Floats) -> tuple[csc_array, Floats]:
        """The matrix and the gradient at `x`; `weights` (edge_count,) multiply the information of each edge."""
        gradient, blocks, first = np.zeros(self.size + 1), [], 0
        for term, places in zip(self._terms, self._places, strict=True):
            error, jacobian = term.errors(x[term.touched], term.measured)
            last = first + len(error)
            weighted = weights[first:last, None, None] * (term.information @ jacobian)
            blocks.append((jacobian.transpose(0, 2, 1) @ weighted).ravel())
            pull = np.einsum("kiv,ki->kv", weighted, error)
            gradient += np.bincount(places.ravel() + 1, weights=pull.ravel(), minlength=self.size + 1)
            first = last
        data = np.bincount(self._slots, weights=np.concatenate(blocks), minlength=len(self._rows) + 1)[1:]
        return csc_array((data, self._rows, self._starts), shape=(self.size, self.size)), gradient[1:]

    def factor(self, matrix: csc_array, damping: Floats) -> SuperLU | None:
        """The factors of (matrix + diag(damping)); None where that is singular."""
        damped = matrix.copy()
        damped.data[self._diagonal] += damping
        try:
            return splu(damped, permc_spec="NATURAL", **CHOLESKY_LIKE)
        except RuntimeError:  # so SuperLU says that it is singular
            return None

    def spreads(self, graph: PoseGraph, x: Floats, factor: SuperLU) -> list[Floats]:
        """J P J', (k, d, d), for each kind of edges of a graph with the same variables; P inverts what is factored."""
        result = []
        for term in _terms(graph):
            _, jacobian = term.errors(x[term.touched], term.measured)
            spread = np.empty((*term.measured.shape, term.measured.shape[1]))
            places = self._place[term.touched]
            for k in range(len(spread)):  # one by one: SuperLU is slow with many right-hand sides
                free = places[k] >= 0
                column = np.zeros((self.size, spread.shape[1]))
                column[places[k][free]] = jacobian[k][:, free].T
                spread[k] = jacobian[k][:, free] @ factor.solve(column)[places[k][free]]
            result.append(spread)
        return result

    def moved(self, x: Floats, change: Floats) -> Floats:
        """`x` with its free variables changed."""
        result = x.copy()
        result[self._order] += change
        return result


def _elimination_order(graph: PoseGraph, free: Flags) -> Integers:
    """The indices of the free variables, so ordered that elimination fills little; found pose by pose, not number by
    number: that is a tenth of the work.
    """
    poses = len(graph.poses)
    count = poses + len(graph.landmarks)
    source = np.concatenate([edges.source for edges in graph.kinds])
    target = np.concatenate([graph.motions.target, *(poses + edges.target for edges in graph.kinds[1:])])
    links = coo_array((np.full(len(source), -1.0), (source, target)), shape=(count, count)).tocsr()
    pattern = (links + links.T).tocsc()
    dominant = pattern + (1.0 - pattern.sum(axis=0).min(initial=0.0)) * eye_array(count)
    rank = splu(csc_array(dominant), permc_spec="MMD_AT_PLUS_A", **CHOLESKY_LIKE).perm_c
    owner = np.concatenate([np.repeat(np.arange(poses), 3), poses + np.repeat(np.arange(count - poses), 2)])
    order = np.argsort(rank[owner], kind="stable")
    return order[free[order]]

"""chi2 of a pose graph, the sum of e' Omega e, and the normal equations of a Gauss-Newton step.

The variables are x, y, heading of each pose and x, y of each landmark; steps are added to them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array, csc_array, eye_array
from scipy.sparse.linalg import SuperLU, splu

from drivers.immutable import immutable
from drivers.se2 import wrap

from ...geometry.segments import Floats, Integers
from .edge_errors import bearing_errors, motion_errors, position_errors
from .model import Flags, PoseGraph

# Options of SuperLU: the matrices are symmetric and positive definite, so elimination needs no pivoting.
# Origin: definition.
CHOLESKY_LIKE = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


def variables_of(graph: PoseGraph) -> Floats:
    """Return the estimate as one vector (3 n + 2 m,), poses first."""
    return np.concatenate([graph.poses.ravel(), graph.landmarks.ravel()])


def with_variables(graph: PoseGraph, x: Floats) -> PoseGraph:
    """Return the graph with the estimate of a vector like that of `variables_of`; headings are in [-pi, pi)."""
    poses = x[: graph.poses.size].reshape(-1, 3).copy()
    poses[:, 2] = wrap(poses[:, 2])
    return graph.with_estimate(poses, x[graph.poses.size :].reshape(-1, 2).copy())


@immutable
class _Term:
    """Edges of one kind: their error function, and the indices (k, v) of their variables."""

    errors: Callable[[Floats, Floats], tuple[Floats, Floats]]
    measured: Floats
    information: Floats
    variables: Integers


def _terms(graph: PoseGraph) -> tuple[_Term, _Term, _Term]:
    pose, point, first = np.arange(3), np.arange(2), graph.poses.size
    motions, positions, bearings = graph.edges_by_kind
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
    """Return the errors (k, d) of the edges of each kind at the variables `x`."""
    return [term.errors(x[term.variables], term.measured)[0] for term in _terms(graph)]


def edge_chi2(graph: PoseGraph, x: Floats) -> Floats:
    """Return the chi2 (edge_count,) of each edge at the variables `x`."""
    return np.concatenate(
        [
            np.einsum("ki,kij,kj->k", error, edges.information, error)
            for error, edges in zip(edge_errors(graph, x), graph.edges_by_kind, strict=True)
        ]
    )


class NormalEquations:
    """Normal equations J' W Omega J and J' W Omega e of a graph over its `free` (3 n + 2 m,) variables.

    The sparsity pattern and the elimination order are computed once, for all steps.
    """

    def __init__(self, graph: PoseGraph, free: Flags) -> None:
        self._terms = _terms(graph)
        self._order = _elimination_order(graph, free)
        self.size = len(self._order)
        self._column = np.full(len(free), -1, dtype=np.int64)
        self._column[self._order] = np.arange(self.size)
        self._columns = [self._column[term.variables] for term in self._terms]
        self._build_pattern()

    def _build_pattern(self) -> None:
        """Find the slot, in the matrix's compressed columns, to which each entry of each edge's block is added."""
        keys = [
            np.where((p[:, :, None] < 0) | (p[:, None, :] < 0), -1, p[:, :, None] * self.size + p[:, None, :]).ravel()
            for p in self._columns
        ]
        diagonal = np.arange(self.size) * (self.size + 1)
        entries, slots = np.unique(np.concatenate([[-1], diagonal, *keys]), return_inverse=True)
        self._diagonal = slots[1 : self.size + 1] - 1  # entry 0 collects the entries of fixed variables
        self._slots = slots[self.size + 1 :]
        columns, self._rows = np.divmod(entries[1:], max(self.size, 1))
        self._starts = np.searchsorted(columns, np.arange(self.size + 1))

    def linearise(self, x: Floats, weights: Floats) -> tuple[csc_array, Floats]:
        """Return the matrix and the gradient at `x`; `weights` (edge_count,) multiply the information of each edge."""
        gradient, blocks, first = np.zeros(self.size + 1), [], 0
        for term, columns in zip(self._terms, self._columns, strict=True):
            error, jacobian = term.errors(x[term.variables], term.measured)
            last = first + len(error)
            weighted = weights[first:last, None, None] * (term.information @ jacobian)
            blocks.append((jacobian.transpose(0, 2, 1) @ weighted).ravel())
            edge_gradient = np.einsum("kiv,ki->kv", weighted, error)
            gradient += np.bincount(columns.ravel() + 1, weights=edge_gradient.ravel(), minlength=self.size + 1)
            first = last
        data = np.bincount(self._slots, weights=np.concatenate(blocks), minlength=len(self._rows) + 1)[1:]
        return csc_array((data, self._rows, self._starts), shape=(self.size, self.size)), gradient[1:]

    def factor(self, matrix: csc_array, damping: Floats) -> SuperLU | None:
        """Factorise (matrix + diag(damping)); return None if it is singular."""
        damped = matrix.copy()
        damped.data[self._diagonal] += damping
        try:
            return splu(damped, permc_spec="NATURAL", **CHOLESKY_LIKE)
        except RuntimeError:  # raised by SuperLU if the matrix is singular
            return None

    def edge_covariances(self, graph: PoseGraph, x: Floats, factor: SuperLU) -> list[Floats]:
        """Return J P J', (k, d, d), for each kind of edges of a graph with the same variables.

        P is the inverse of the factorised matrix.
        """
        result = []
        for term in _terms(graph):
            _, jacobian = term.errors(x[term.variables], term.measured)
            covariance = np.empty((*term.measured.shape, term.measured.shape[1]))
            columns = self._column[term.variables]
            for k in range(len(covariance)):  # one by one: SuperLU is slow with many right-hand sides
                free = columns[k] >= 0
                right = np.zeros((self.size, covariance.shape[1]))
                right[columns[k][free]] = jacobian[k][:, free].T
                covariance[k] = jacobian[k][:, free] @ factor.solve(right)[columns[k][free]]
            result.append(covariance)
        return result

    def apply_step(self, x: Floats, step: Floats) -> Floats:
        """Return `x` with `step` (size,) added to its free variables."""
        result = x.copy()
        result[self._order] += step
        return result


def _elimination_order(graph: PoseGraph, free: Flags) -> Integers:
    """Return the indices of the free variables in an order with little fill-in.

    The order is computed for poses and landmarks, not for single variables, which takes a tenth of the time.
    """
    poses = len(graph.poses)
    count = poses + len(graph.landmarks)
    source = np.concatenate([edges.source for edges in graph.edges_by_kind])
    target = np.concatenate([graph.motions.target, *(poses + edges.target for edges in graph.edges_by_kind[1:])])
    links = coo_array((np.full(len(source), -1.0), (source, target)), shape=(count, count)).tocsr()
    pattern = (links + links.T).tocsc()
    dominant = pattern + (1.0 - pattern.sum(axis=0).min(initial=0.0)) * eye_array(count)
    rank = splu(csc_array(dominant), permc_spec="MMD_AT_PLUS_A", **CHOLESKY_LIKE).perm_c
    owner = np.concatenate([np.repeat(np.arange(poses), 3), poses + np.repeat(np.arange(count - poses), 2)])
    order = np.argsort(rank[owner], kind="stable")
    return order[free[order]]

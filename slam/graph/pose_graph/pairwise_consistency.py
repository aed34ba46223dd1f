"""Pairwise consistency of loop edges, from odometry alone and before any optimisation.

Two edges i -> j and k -> l with i near k and j near l along the trajectory form a short cycle with the odometry between
them: its error E, the composed motion around it, is small if both are true. With S the covariance of E, propagated from
the four parts, they are consistent if E is much more likely than by chance (Mangelson et al. 2018):

    log p(E | both true) - log p(E | unrelated) > MIN_LOG_RATIO,     p(E | both true) = N(E; 0, S)
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from drivers import se2

from ...geometry.segments import Floats, Integers
from .model import Edges, Flags, PoseGraph

# Poses along the trajectory within which two loop edges are compared. Origin: measured, on public graphs at least three
# quarters of the true loops have a consistent one within this; of as many random false loops, one in a hundred.
MAX_INDEX_DISTANCE = 20
# Log-likelihood ratio above which two loop edges are consistent. Origin: chosen; not measured.
MIN_LOG_RATIO = 4.0
# Regularisation of an information matrix relative to its largest entry, so that it has an inverse. Origin: numerical.
REGULARISATION = 1e-9


def odometry_edges(graph: PoseGraph) -> Flags:
    """Return a mask (edge_count,) of odometry: the first edge between any two poses with successive ids."""
    rank = np.argsort(np.argsort(graph.pose_ids))
    low = np.minimum(rank[graph.motions.source], rank[graph.motions.target])
    following = np.flatnonzero(np.abs(rank[graph.motions.target] - rank[graph.motions.source]) == 1)
    result = np.zeros(graph.edge_count, dtype=bool)
    result[following[np.unique(low[following], return_index=True)[1]]] = True
    return result


def count_consistent_loops(graph: PoseGraph, odometry: Flags) -> Integers:
    """Return the number (edge_count,) of loop edges consistent with each loop edge; 0 for all other edges."""
    chain = _Chain(graph, odometry[: len(graph.motions)])
    loops = np.flatnonzero(~odometry[: len(graph.motions)])
    result = np.zeros(graph.edge_count, dtype=np.int64)
    i, j, measured, covariance = _forward(graph.motions.select(~odometry[: len(graph.motions)]), chain.rank)
    pairs = (
        cKDTree(np.column_stack([i, j])).query_pairs(MAX_INDEX_DISTANCE, p=np.inf, output_type="ndarray")
        if len(i)
        else []
    )
    if len(pairs) == 0:
        return result
    a, b = np.transpose(pairs)
    connected = (chain.part[i[a]] == chain.part[i[b]]) & (chain.part[j[a]] == chain.part[j[b]])
    a, b = a[connected], b[connected]
    # the cycle: i_a -> i_b by odometry, the edge b, j_b -> j_a by odometry, the edge a backwards
    first, first_covariance = chain.between(i[a], i[b])
    second, second_covariance = chain.between(j[b], j[a])
    after_b = se2.compose(first, measured[b])
    end = se2.compose(after_b, second)
    error = se2.compose(end, se2.inverse(measured[a]))
    error_covariance = (
        _transform_covariance(first_covariance, first)
        + _transform_covariance(covariance[b], after_b)
        + _transform_covariance(second_covariance, end)
        + _transform_covariance(covariance[a], end)
    )
    squared = np.einsum("ki,ki->k", error, np.linalg.solve(error_covariance, error[:, :, None])[:, :, 0])
    log_ratio = -0.5 * squared - 0.5 * np.linalg.slogdet(error_covariance)[1] - _unrelated_log_density(measured)
    consistent = log_ratio > MIN_LOG_RATIO
    result[loops] = np.bincount(np.concatenate([a[consistent], b[consistent]]), minlength=len(loops))
    return result


class _Chain:
    """Trajectory by odometry alone, in the order of the pose ids, with its covariance."""

    def __init__(self, graph: PoseGraph, odometry: Flags) -> None:
        count = len(graph.poses)
        self.rank: Integers = np.argsort(np.argsort(graph.pose_ids))
        steps = graph.motions.select(odometry)
        start, _, motion, covariance = _forward(steps, self.rank)
        motions, covariances = np.zeros((count - 1, 3)), np.zeros((count - 1, 3, 3))
        motions[start], covariances[start] = motion, covariance
        present = np.zeros(count - 1, dtype=bool)
        present[start] = True
        self.part = np.concatenate([[0], np.cumsum(~present)])
        self.poses = np.zeros((count, 3))
        for k in range(count - 1):
            self.poses[k + 1] = se2.compose(self.poses[k], motions[k])
        # transformed to the origin, the covariances of independent steps add up
        self._covariance = np.zeros((count, 3, 3))
        self._covariance[1:] = np.cumsum(_transform_covariance(covariances, self.poses[1:]), axis=0)

    def between(self, start: Integers, end: Integers) -> tuple[Floats, Floats]:
        """Return motions (k, 3) between poses of the same connected part, and their covariances at their ends."""
        forward = np.where(end >= start, 1.0, -1.0)[:, None, None]
        covariance = forward * (self._covariance[end] - self._covariance[start])
        motion = se2.between(self.poses[start], self.poses[end])
        return motion, _transform_covariance(covariance, se2.inverse(self.poses[end]))


def _forward(edges: Edges, rank: Integers) -> tuple[Integers, Integers, Floats, Floats]:
    """Return the ranks of the earlier and the later pose of each edge, the motion between them, and its covariance
    (k, 3, 3) at the later one."""
    source, target = rank[edges.source], rank[edges.target]
    backward = source > target
    largest = np.abs(edges.information).max(axis=(1, 2), initial=1e-300)[:, None, None]
    covariance = np.linalg.inv(edges.information + REGULARISATION * largest * np.eye(3))
    measured = edges.measured.copy()
    covariance[backward] = _transform_covariance(covariance[backward], measured[backward])
    measured[backward] = se2.inverse(measured[backward])
    return np.minimum(source, target), np.maximum(source, target), measured, covariance


def _transform_covariance(covariance: Floats, pose: Floats) -> Floats:
    """Transform covariances (k, 3, 3) from frames at `pose` (k, 3) to the frame in which the poses are given."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    adjoint = np.zeros((len(pose), 3, 3))
    adjoint[:, 0], adjoint[:, 1] = np.stack([c, -s, pose[:, 1]], axis=-1), np.stack([s, c, -pose[:, 0]], axis=-1)
    adjoint[:, 2, 2] = 1.0
    return np.asarray(adjoint @ covariance @ adjoint.transpose(0, 2, 1))


def _unrelated_log_density(measured: Floats) -> float:
    """Return the expected log density, without the factor of pi, of the error of a cycle through two unrelated edges.

    The error is modelled as normal with twice the covariance of the measurements.
    """
    covariance = 2.0 * np.cov(measured.T) + 1e-12 * np.eye(3)
    return float(-0.5 * np.linalg.slogdet(covariance)[1] - 1.5)

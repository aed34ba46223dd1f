"""Which loop edges are borne out by others, told from odometry alone and before anything is solved.

Two edges i -> j and k -> l with i near k and j near l along the path close a short cycle with the odometry between: its
error E, the composed motion around it, is small if both are true. With S the covariance of E, propagated from the four
parts, they support each other when E is far likelier so than by chance (pairwise consistency: Mangelson et al. 2018):

    log p(E | both true) - log p(E | unrelated) > LIKELIER,     p(E | both true) = N(E; 0, S)
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from drivers import se2

from .model import Edges, Flags, Floats, Integers, PoseGraph

NEAR = 20
"""Poses along the path. On public graphs three quarters of the true loops and more have a partner within this; among as
many false ones drawn at random, one in a hundred."""
LIKELIER = 4.0
"""Log-likelihood ratio."""
UNMEASURED = 1e-9
"""Share of an information matrix's largest number that stands in for none, so that it has an inverse."""


def odometry_edges(graph: PoseGraph) -> Flags:
    """(edge_count,): the first edge between each two poses that follow each other in the order of their ids."""
    rank = np.argsort(np.argsort(graph.pose_ids))
    low = np.minimum(rank[graph.motions.source], rank[graph.motions.target])
    following = np.flatnonzero(np.abs(rank[graph.motions.target] - rank[graph.motions.source]) == 1)
    result = np.zeros(graph.edge_count, dtype=bool)
    result[following[np.unique(low[following], return_index=True)[1]]] = True
    return result


def count_partners(graph: PoseGraph, odometry: Flags) -> Integers:
    """(edge_count,): how many others bear out each motion that is not odometry; 0 for all other edges."""
    chain = _Chain(graph, odometry[: len(graph.motions)])
    loops = np.flatnonzero(~odometry[: len(graph.motions)])
    result = np.zeros(graph.edge_count, dtype=np.int64)
    i, j, measured, covariance = _forward(graph.motions.select(~odometry[: len(graph.motions)]), chain.rank)
    pairs = cKDTree(np.column_stack([i, j])).query_pairs(NEAR, p=np.inf, output_type="ndarray") if len(i) else []
    if len(pairs) == 0:
        return result
    a, b = np.transpose(pairs)
    whole = (chain.part[i[a]] == chain.part[i[b]]) & (chain.part[j[a]] == chain.part[j[b]])
    a, b = a[whole], b[whole]
    # around: i_a -> i_b along the path, the edge b, j_b -> j_a along the path, the edge a backwards
    out, out_covariance = chain.between(i[a], i[b])
    home, home_covariance = chain.between(j[b], j[a])
    there = se2.compose(out, measured[b])
    end = se2.compose(there, home)
    error = se2.compose(end, se2.inverse(measured[a]))
    spread = (
        _carried(out_covariance, out)
        + _carried(covariance[b], there)
        + _carried(home_covariance, end)
        + _carried(covariance[a], end)
    )
    squared = np.einsum("ki,ki->k", error, np.linalg.solve(spread, error[:, :, None])[:, :, 0])
    ratio = -0.5 * squared - 0.5 * np.linalg.slogdet(spread)[1] - _unrelated(measured)
    agree = ratio > LIKELIER
    result[loops] = np.bincount(np.concatenate([a[agree], b[agree]]), minlength=len(loops))
    return result


class _Chain:
    """The path by odometry alone, in the order of the poses' ids, and how uncertain it becomes."""

    def __init__(self, graph: PoseGraph, odometry: Flags) -> None:
        count = len(graph.poses)
        self.rank: Integers = np.argsort(np.argsort(graph.pose_ids))
        steps = graph.motions.select(odometry)
        start, _, motion, covariance = _forward(steps, self.rank)
        moved, noise = np.zeros((count - 1, 3)), np.zeros((count - 1, 3, 3))
        moved[start], noise[start] = motion, covariance
        present = np.zeros(count - 1, dtype=bool)
        present[start] = True
        self.part = np.concatenate([[0], np.cumsum(~present)])
        self.poses = np.zeros((count, 3))
        for k in range(count - 1):
            self.poses[k + 1] = se2.compose(self.poses[k], moved[k])
        # as small motions of the origin's frame the steps' errors simply add up
        self._spread = np.zeros((count, 3, 3))
        self._spread[1:] = np.cumsum(_carried(noise, self.poses[1:]), axis=0)

    def between(self, start: Integers, end: Integers) -> tuple[Floats, Floats]:
        """Motions (k, 3) from some poses to others of the same part, and their covariances at their ends."""
        forward = np.where(end >= start, 1.0, -1.0)[:, None, None]
        spread = forward * (self._spread[end] - self._spread[start])
        motion = se2.between(self.poses[start], self.poses[end])
        return motion, _carried(spread, se2.inverse(self.poses[end]))


def _forward(edges: Edges, rank: Integers) -> tuple[Integers, Integers, Floats, Floats]:
    """Ranks of the earlier and the later pose, the motion between and its covariance (k, 3, 3) at the later one."""
    source, target = rank[edges.source], rank[edges.target]
    back = source > target
    largest = np.abs(edges.information).max(axis=(1, 2), initial=1e-300)[:, None, None]
    covariance = np.linalg.inv(edges.information + UNMEASURED * largest * np.eye(3))
    measured = edges.measured.copy()
    covariance[back] = _carried(covariance[back], measured[back])
    measured[back] = se2.inverse(measured[back])
    return np.minimum(source, target), np.maximum(source, target), measured, covariance


def _carried(covariance: Floats, pose: Floats) -> Floats:
    """Covariances (k, 3, 3) of small motions of frames, as ones of the frame that their poses (k, 3) are given in."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    adjoint = np.zeros((len(pose), 3, 3))
    adjoint[:, 0], adjoint[:, 1] = np.stack([c, -s, pose[:, 1]], axis=-1), np.stack([s, c, -pose[:, 0]], axis=-1)
    adjoint[:, 2, 2] = 1.0
    return np.asarray(adjoint @ covariance @ adjoint.transpose(0, 2, 1))


def _unrelated(measured: Floats) -> float:
    """The typical log density, without the factor of pi, of a cycle through two edges that have nothing to do with each
    other: a normal one as wide as two measurements together.
    """
    wide = 2.0 * np.cov(measured.T) + 1e-12 * np.eye(3)
    return float(-0.5 * np.linalg.slogdet(wide)[1] - 1.5)

"""Optimise graphs with false edges by graduated non-convexity and truncated least squares.

Odometry, the edges between successive poses, is taken as correct. Every other edge is an inlier or an outlier: an
outlier if its error is implausible. Graduated non-convexity (Yang et al. 2020) decides this from an initial estimate
that is not too wrong. It starts with the loop edges that are consistent with others; the rest is admitted afterwards,
each by its innovation,

    e' (Omega^-1 + J P J')^-1 e,     P the covariance of the estimate without the edge,

because a false edge in the graph has deformed it so that its own error is small. The inliers are tested in this way at
the end. Information matrices are often too small by a large factor: errors are compared with a quantile of the graph's
own errors if that is less than the information matrices predict.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from ...geometry.segments import Floats
from .initialisation import initialise
from .least_squares import NormalEquations, edge_chi2, edge_errors
from .levenberg_marquardt import minimise, positive_diagonal
from .model import Flags, PoseGraph
from .pairwise_consistency import count_consistent_loops, odometry_edges
from .spanning_tree import components

# Share of true edges rejected if the information matrices are correct and the errors normal.
# Origin: chosen; not measured.
FALSE_ALARM_RATE = 1e-4
# Number of other loop edges with which one must be consistent to be used in the initial estimate.
# Origin: measured, two false edges agree by chance a hundred times more often than three.
MIN_CONSISTENT_LOOPS = 2
# Quantile from which the scale of the errors is estimated, and the multiple of it that is allowed, as real errors have
# heavy tails. For the initial inliers, of which fewer than a tenth are false; rejected edges can still be admitted.
# Origin: chosen; not measured.
INITIAL_SCALE = (0.9, 3.0)
# The same for the final inliers. False edges with an innovation below that remain.
# Origin: measured, on public graphs the innovation of true edges is up to 5.6 times what the quantile predicts.
FINAL_SCALE = (0.95, 7.0)
# Relative regularisation for the innovation of an edge that alone determines a variable; its error is zero.
# Origin: numerical.
INNOVATION_REGULARISATION = 1e-9
# Number of edges besides odometry below which their scale is not estimated.
# Origin: chosen, fewer do not determine the scale; not measured.
MIN_LOOP_EDGES = 30
# Growth of the control parameter mu per iteration. Origin: definition, Yang et al. 2020.
MU_GROWTH = 1.4
# Smallest ratio of an edge's chi2 to its gate. Origin: numerical.
MIN_RATIO = 1e-12
# Maximum number of iterations of graduated non-convexity. Origin: chosen, a safeguard; not measured.
MAX_GRADUATIONS = 100
# Maximum number of rounds of admission and rejection. Origin: chosen, a safeguard; not measured.
MAX_ADMISSIONS = 20
# Damping relative to the diagonal: the covariance of undetermined variables is large, not infinite. Origin: numerical.
MIN_DAMPING = 1e-12


def solve_robustly(graph: PoseGraph, free: Flags) -> tuple[Floats, Flags]:
    """Return the variables at the optimum of the inlier edges, and the mask (edge_count,) of these."""
    odometry = odometry_edges(graph)
    inliers = odometry | (count_consistent_loops(graph, odometry) >= MIN_CONSISTENT_LOOPS)
    inliers[len(graph.motions) :] = True  # landmarks have too many observations for pairwise tests to be informative
    if len(np.unique(components(graph.select_edges(inliers)))) > len(np.unique(components(graph))):
        inliers[:] = True
    initial = graph.select_edges(inliers)
    x, _ = minimise(initial, NormalEquations(initial, free), initialise(initial, free))
    gate = _gates(graph)
    scale = _scale(initial, x, odometry[inliers], *INITIAL_SCALE)
    x, remaining = _graduate(initial, free, x, odometry[inliers], scale * gate[inliers])
    inliers[inliers] = remaining
    return _admit(graph, free, x, odometry, inliers)


def _gates(graph: PoseGraph, rate: float = FALSE_ALARM_RATE) -> Floats:
    """Return the chi2 (edge_count,) that this share of edges exceeds if the information matrices are correct."""
    return np.concatenate([np.full(len(edges), chdtri(edges.measured.shape[1], rate)) for edges in graph.edges_by_kind])


def _scale(graph: PoseGraph, x: Floats, odometry: Flags, quantile: float, multiple: float) -> float:
    """Return the factor, at most 1, that adapts the gates to the errors of the edges at `x`."""
    ratios = (edge_chi2(graph, x) / _gates(graph, 1.0 - quantile))[~odometry]
    return min(1.0, multiple * float(np.quantile(ratios, quantile))) if len(ratios) >= MIN_LOOP_EDGES else 1.0


def _graduate(graph: PoseGraph, free: Flags, x: Floats, odometry: Flags, gate: Floats) -> tuple[Floats, Flags]:
    """Run graduated non-convexity from `x`; return the variables and the mask (edge_count,) of edges within their
    gates."""
    ratio = np.maximum(edge_chi2(graph, x) / gate, MIN_RATIO)
    mu = 1.0 / max(2.0 * float(ratio[~odometry].max(initial=0.0)) - 1.0, MIN_RATIO)
    weights = np.ones(graph.edge_count)
    present, equations = np.zeros(0, dtype=bool), None
    for _ in range(MAX_GRADUATIONS):
        before, weights = weights, np.clip(np.sqrt(mu * (mu + 1.0) / ratio) - mu, 0.0, 1.0)
        weights[odometry] = 1.0
        if equations is None or not np.array_equal(present, weights > 0.0):
            present = weights > 0.0
            part = graph.select_edges(present)
            equations = NormalEquations(part, free)
        x, _ = minimise(part, equations, x, weights[present], steps=1)
        if np.isin(weights, (0.0, 1.0)).all() and np.array_equal(weights, before):
            break
        ratio = np.maximum(edge_chi2(graph, x) / gate, MIN_RATIO)
        mu *= MU_GROWTH
    return x, weights > 0.5


def _admit(graph: PoseGraph, free: Flags, x: Floats, odometry: Flags, inliers: Flags) -> tuple[Floats, Flags]:
    """Solve with the `inliers`, admit edges that fit and reject those that do not, until nothing changes."""
    gate = _gates(graph)
    for _ in range(MAX_ADMISSIONS):
        part = graph.select_edges(inliers)
        equations = NormalEquations(part, free)
        # from a new initial estimate, too: after a large loop closure the old one may lead to another local minimum
        x, _ = min((minimise(part, equations, start) for start in (x, initialise(part, free))), key=lambda s: s[1])
        scale = _scale(part, x, odometry[inliers], *FINAL_SCALE)
        ratio = edge_chi2(graph, x) / gate
        fits = odometry | (ratio <= scale)
        outside = ~inliers & ~fits
        fits[outside] = _innovations(graph.select_edges(outside), 1.0, part, equations, x) <= scale * gate[outside]
        if np.array_equal(fits, inliers):
            inside = inliers & ~odometry
            fits[inside] = _innovations(graph.select_edges(inside), -1.0, part, equations, x) <= scale * gate[inside]
        if np.array_equal(fits, inliers):
            break
        inliers = fits
    part = graph.select_edges(inliers)
    return minimise(part, NormalEquations(part, free), x)[0], inliers


def _innovations(candidates: PoseGraph, sign: float, graph: PoseGraph, equations: NormalEquations, x: Floats) -> Floats:
    """Return the innovations (edge_count,) of candidate edges relative to the graph without them.

    With C = J P J' and the sign +1 for edges that are not in the graph, -1 for edges that are:
    e' (Omega^-1 +- C)^-1 e = e' (1 +- Omega C)^-1 Omega e, in which Omega may be singular.
    """
    matrix, _ = equations.linearise(x, np.ones(graph.edge_count))
    factor = equations.factor(matrix, MIN_DAMPING * positive_diagonal(matrix))
    if factor is None:
        return np.full(candidates.edge_count, np.inf)
    result = []
    covariances = equations.edge_covariances(candidates, x, factor)
    for edges, error, covariance in zip(candidates.edges_by_kind, edge_errors(candidates, x), covariances, strict=True):
        weighted = edges.information @ error[:, :, None]
        identity = (1.0 + INNOVATION_REGULARISATION) * np.eye(error.shape[1])
        solved = np.linalg.solve(identity + sign * edges.information @ covariance, weighted)
        result.append((error[:, None, :] @ solved)[:, 0, 0])
    return np.concatenate(result)

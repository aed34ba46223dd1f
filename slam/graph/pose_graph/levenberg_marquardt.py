"""Local optimum by the Levenberg-Marquardt method, with the damping strategy of Nielsen (1999)."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array

from ...geometry.segments import Floats
from .least_squares import NormalEquations, edge_chi2
from .model import PoseGraph

# Maximum number of steps. Origin: numerical, a safeguard.
MAX_STEPS = 100
# Relative decrease of chi2 below which a step is the last one. Origin: numerical, far below the 0.5 % by which optima
# are compared.
CONVERGED_DECREASE = 1e-9
# Initial damping relative to the diagonal: nearly Gauss-Newton; it increases at once if that fails.
# Origin: numerical, Nielsen's recommendation for a good initial estimate.
INITIAL_DAMPING = 1e-6
# Damping relative to the diagonal at which the search ends. Origin: numerical.
MAX_DAMPING = 1e12
# Smallest diagonal entry relative to the largest one: undetermined variables stay where they are. Origin: numerical.
MIN_DIAGONAL = 1e-12


def minimise(
    graph: PoseGraph, equations: NormalEquations, x: Floats, weights: Floats | None = None, steps: int = MAX_STEPS
) -> tuple[Floats, float]:
    """Return the variables at the local minimum of the weighted chi2 reached from `x`, and that chi2.

    `weights` (edge_count,) multiply the chi2 of each edge; the default is one.
    """
    weights = np.ones(graph.edge_count) if weights is None else weights
    cost = float(weights @ edge_chi2(graph, x))
    if equations.size == 0:
        return x, cost
    damping, growth = INITIAL_DAMPING, 2.0
    matrix, gradient = equations.linearise(x, weights)
    for _ in range(steps):
        scale = positive_diagonal(matrix)
        factor = equations.factor(matrix, damping * scale)
        step = np.full(equations.size, np.nan) if factor is None else factor.solve(-gradient)
        predicted = float(step @ (damping * scale * step - gradient))
        candidate = equations.apply_step(x, step)
        candidate_cost = float(weights @ edge_chi2(graph, candidate)) if np.isfinite(predicted) else np.inf
        gain = cost - candidate_cost
        if gain > 0.0:
            x, cost = candidate, candidate_cost
            damping, growth = damping * max(1.0 / 3.0, 1.0 - (2.0 * gain / predicted - 1.0) ** 3), 2.0
            matrix, gradient = equations.linearise(x, weights)
        else:
            damping, growth = damping * growth, 2.0 * growth
        if min(predicted, abs(gain)) <= CONVERGED_DECREASE * cost or damping > MAX_DAMPING:
            break
    return x, cost


def positive_diagonal(matrix: csc_array) -> Floats:
    """Return the diagonal of a matrix of normal equations; zeros of undetermined variables become positive."""
    diagonal = matrix.diagonal()
    return np.asarray(np.maximum(diagonal, max(MIN_DIAGONAL * diagonal.max(), np.finfo(float).tiny)))

"""The optimum near an estimate: Levenberg's and Marquardt's method, with Nielsen's way of choosing the damping."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array

from .least_squares import NormalEquations, edge_chi2
from .model import Floats, PoseGraph

MOST_STEPS = 100
SETTLED = 1e-9
"""A step that lowers chi2 by less than this share of it is the last: 0.5 % of an optimum is far more."""
FIRST_DAMPING = 1e-6
"""As a share of the diagonal: nearly Gauss-Newton, which is fast where it works; it grows at once where not."""
MOST_DAMPING = 1e12
LEAST_DIAGONAL = 1e-12
"""As a share of the largest: a variable that nothing determines is held where it is."""


def minimise(
    graph: PoseGraph, equations: NormalEquations, x: Floats, weights: Floats | None = None, steps: int = MOST_STEPS
) -> tuple[Floats, float]:
    """The variables with the least weighted chi2 that is found downhill from `x`, and that chi2.

    `weights` (edge_count,) multiply the chi2 of each edge; all ones where not given.
    """
    weights = np.ones(graph.edge_count) if weights is None else weights
    cost = float(weights @ edge_chi2(graph, x))
    if equations.size == 0:
        return x, cost
    damping, growth = FIRST_DAMPING, 2.0
    matrix, gradient = equations.at(x, weights)
    for _ in range(steps):
        scale = held_diagonal(matrix)
        factor = equations.factor(matrix, damping * scale)
        change = np.full(equations.size, np.nan) if factor is None else factor.solve(-gradient)
        promised = float(change @ (damping * scale * change - gradient))
        tried = equations.moved(x, change)
        tried_cost = float(weights @ edge_chi2(graph, tried)) if np.isfinite(promised) else np.inf
        gain = cost - tried_cost
        if gain > 0.0:
            x, cost = tried, tried_cost
            damping, growth = damping * max(1.0 / 3.0, 1.0 - (2.0 * gain / promised - 1.0) ** 3), 2.0
            matrix, gradient = equations.at(x, weights)
        else:
            damping, growth = damping * growth, 2.0 * growth
        if min(promised, abs(gain)) <= SETTLED * cost or damping > MOST_DAMPING:
            break
    return x, cost


def held_diagonal(matrix: csc_array) -> Floats:
    """The diagonal of such a matrix, made positive where nothing determines a variable."""
    diagonal = matrix.diagonal()
    return np.asarray(np.maximum(diagonal, max(LEAST_DIAGONAL * diagonal.max(), np.finfo(float).tiny)))

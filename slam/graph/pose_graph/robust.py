"""Optimisation of graphs with false edges, by graduated non-convexity and truncated least squares.

Odometry, the edges between poses that follow each other, is believed. Of the others each is in or out in the end: out
if its error is implausible. Graduated non-convexity (Yang et al. 2020) finds this from a start that is not too wrong.
So it begins with those loop edges that others bear out; the rest is admitted afterwards, each by its innovation,

    e' (Omega^-1 + J P J')^-1 e,     P the covariance of the estimate without the edge,

since a false edge that is in has bent the graph so that its own error is small. Those that are in are tested so at the
end. Information matrices are often cautious by a large factor: errors are compared with a quantile of those that the
graph itself shows, where that is less than what the matrices claim.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from .initialisation import initialise
from .least_squares import NormalEquations, edge_chi2, edge_errors
from .model import Flags, Floats, PoseGraph
from .placing import components
from .solver import held_diagonal, minimise
from .support import count_partners, odometry_edges

FALSE_ALARM = 1e-4
"""The share of true edges that would be put out were the information matrices right and the errors normal."""
PARTNERS = 2
"""Two false edges may happen to agree; that three do is a hundred times rarer."""
AT_FIRST, FINALLY = (0.9, 3.0), (0.95, 7.0)
"""Quantiles that tell the errors' scale, and what multiple of it is allowed, as real errors have heavy tails. At first
fewer than a tenth of the edges are false, and what is put out can still come back. Finally: on public graphs a true
edge's innovation is up to 5.6 times what the quantile makes plausible. False edges below that stay in."""
UNDETERMINED = 1e-9
"""Keeps finite what an edge that alone determines something is compared with; its error is zero then."""
ENOUGH = 30
"""Edges besides odometry; fewer tell nothing of the scale."""
GRADUATION = 1.4
"""Growth of the control parameter mu, as its authors have it."""
LEAST_RATIO = 1e-12
"""For edges without any error."""
MOST_GRADUATIONS = 100
MOST_ADMISSIONS = 20
LEAST_DAMPING = 1e-12
"""As a share of the diagonal: what nothing determines gets a covariance that is large, not infinite."""


def solve_robustly(graph: PoseGraph, free: Flags) -> tuple[Floats, Flags]:
    """The optimum of the edges that are believed, as variables, and which these are (edge_count,)."""
    trusted = odometry_edges(graph)
    begin = trusted | (count_partners(graph, trusted) >= PARTNERS)
    begin[len(graph.motions) :] = True  # landmarks are seen too often for pairs to tell anything
    if len(np.unique(components(graph.select_edges(begin)))) > len(np.unique(components(graph))):
        begin[:] = True
    first = graph.select_edges(begin)
    x, _ = minimise(first, NormalEquations(first, free), initialise(first, free))
    gate = _gates(graph)
    scale = _scale(first, x, trusted[begin], *AT_FIRST)
    x, kept = _graduate(first, free, x, trusted[begin], scale * gate[begin])
    begin[begin] = kept
    return _admit(graph, free, x, trusted, begin)


def _gates(graph: PoseGraph, share: float = FALSE_ALARM) -> Floats:
    """(edge_count,): the chi2 that this share of edges exceeds, where the information matrices are right."""
    return np.concatenate([np.full(len(e), chi2_distribution.isf(share, e.measured.shape[1])) for e in graph.kinds])


def _scale(graph: PoseGraph, x: Floats, trusted: Flags, quantile: float, tail: float) -> float:
    """What the gates are to be multiplied with for the errors that the edges show at `x`, at most 1."""
    ratios = (edge_chi2(graph, x) / _gates(graph, 1.0 - quantile))[~trusted]
    return min(1.0, tail * float(np.quantile(ratios, quantile))) if len(ratios) >= ENOUGH else 1.0


def _graduate(graph: PoseGraph, free: Flags, x: Floats, trusted: Flags, gate: Floats) -> tuple[Floats, Flags]:
    """Graduated non-convexity from `x`: the variables, and which edges have chi2 below their gates (edge_count,)."""
    ratio = np.maximum(edge_chi2(graph, x) / gate, LEAST_RATIO)
    mu = 1.0 / max(2.0 * float(ratio[~trusted].max(initial=0.0)) - 1.0, LEAST_RATIO)
    weights = np.ones(graph.edge_count)
    present, equations = np.zeros(0, dtype=bool), None
    for _ in range(MOST_GRADUATIONS):
        before, weights = weights, np.clip(np.sqrt(mu * (mu + 1.0) / ratio) - mu, 0.0, 1.0)
        weights[trusted] = 1.0
        if equations is None or not np.array_equal(present, weights > 0.0):
            present = weights > 0.0
            part = graph.select_edges(present)
            equations = NormalEquations(part, free)
        x, _ = minimise(part, equations, x, weights[present], steps=1)
        if np.isin(weights, (0.0, 1.0)).all() and np.array_equal(weights, before):
            break
        ratio = np.maximum(edge_chi2(graph, x) / gate, LEAST_RATIO)
        mu *= GRADUATION
    return x, weights > 0.5


def _admit(graph: PoseGraph, free: Flags, x: Floats, trusted: Flags, kept: Flags) -> tuple[Floats, Flags]:
    """Solve with the edges `kept`, let in what fits, put out what does not, until nothing changes."""
    gate = _gates(graph)
    for _ in range(MOST_ADMISSIONS):
        part = graph.select_edges(kept)
        equations = NormalEquations(part, free)
        # from a fresh start, too: after a large loop is closed the old estimate leads into some other minimum
        x, _ = min((minimise(part, equations, start) for start in (x, initialise(part, free))), key=lambda s: s[1])
        scale = _scale(part, x, trusted[kept], *FINALLY)
        ratio = edge_chi2(graph, x) / gate
        fits = trusted | (ratio <= scale)
        outside = ~kept & ~fits
        fits[outside] = _innovations(graph.select_edges(outside), 1.0, part, equations, x) <= scale * gate[outside]
        if np.array_equal(fits, kept):
            inside = kept & ~trusted
            fits[inside] = _innovations(graph.select_edges(inside), -1.0, part, equations, x) <= scale * gate[inside]
        if np.array_equal(fits, kept):
            break
        kept = fits
    part = graph.select_edges(kept)
    return minimise(part, NormalEquations(part, free), x)[0], kept


def _innovations(candidates: PoseGraph, sign: float, graph: PoseGraph, equations: NormalEquations, x: Floats) -> Floats:
    """(edge_count,): how far candidates are from what the graph says without them, its uncertainty allowed for.

    With C = J P J' and sign +1 for edges that are not in the graph, -1 for edges that are:
    e' (Omega^-1 +- C)^-1 e = e' (1 +- Omega C)^-1 Omega e, where Omega need have no inverse.
    """
    matrix, _ = equations.at(x, np.ones(graph.edge_count))
    factor = equations.factor(matrix, LEAST_DAMPING * held_diagonal(matrix))
    if factor is None:
        return np.full(candidates.edge_count, np.inf)
    result = []
    for edges, error, spread in zip(
        candidates.kinds, edge_errors(candidates, x), equations.spreads(candidates, x, factor), strict=True
    ):
        pull = edges.information @ error[:, :, None]
        unit = (1.0 + UNDETERMINED) * np.eye(error.shape[1])
        shrunk = np.linalg.solve(unit + sign * edges.information @ spread, pull)
        result.append((error[:, None, :] @ shrunk)[:, 0, 0])
    return np.concatenate(result)

"""Solution of a factor graph at the end of a run: all of it at once, with what single updates leave out."""

from __future__ import annotations

from contextlib import suppress

from gtsam.symbol_shorthand import L, X

from ..errors import MapError
from .array_graph import ArrayGraph
from .factor_graph import Additions, FactorGraph
from .factors import FactorKind, from_pose2
from .range_bias import estimate_range_bias
from .wall_correlation import with_correlated_errors

# Gauss-Newton steps of `relinearize_all`, the last one by the incremental solver. Origin: chosen; not measured.
BATCH_STEPS = 3


def solve_with_range_bias(graph: FactorGraph) -> None:
    """Estimate the range bias together with the graph, and solve everything again without it.

    The estimate has converged. If no observation depends on the range bias, none is estimated.
    """
    solver = graph.solver
    arrays = ArrayGraph(solver.sorted_factors(), solver.range_bias.metres)
    values = arrays.values_of(solver.isam.calculateEstimate())
    solver.range_bias = estimate_range_bias(arrays, values, solver.range_bias) or solver.range_bias
    relinearize_all(graph)


def correlate_wall_errors(graph: FactorGraph) -> None:
    """Divide the information of walls whose errors repeat with every view.

    Takes effect with `solve_with_range_bias`. The estimate has converged. Doing it again changes little, as the
    residuals are those of the new factors.
    """
    values, factors = graph.solver.isam.calculateEstimate(), graph.solver.factors
    keyframes = {f.first for f in factors.values() if f.kind is FactorKind.WALL_HEADING}
    walls = {f.second for f in factors.values() if f.kind is FactorKind.WALL_HEADING}
    correlated = with_correlated_errors(
        factors,
        {k: from_pose2(values.atPose2(X(k))) for k in keyframes},
        {j: from_pose2(values.atPose2(L(j))) for j in walls},
        graph.solver.range_bias.metres,
    )
    graph.solver.factors = dict(zip(sorted(factors), correlated, strict=True))


def relinearize_all(graph: FactorGraph) -> None:
    """Solve everything again from the present estimate, at the end of a run.

    Incremental solving relinearises only variables that move by more than a threshold; robust weights of the others
    are those of their last linearisation.
    """
    solver = graph.solver
    factors, bias = solver.sorted_factors(), solver.range_bias.metres
    arrays = ArrayGraph(factors, bias)
    values = arrays.values_of(solver.isam.calculateEstimate())
    with suppress(MapError):  # undetermined in this form; the incremental solver may still manage with QR
        for _ in range(BATCH_STEPS - 1):
            values = arrays.retract(values, arrays.step(values, bias))
    graph.additions = Additions(factors, arrays.to_values(values))
    solver.reset()
    graph.update()

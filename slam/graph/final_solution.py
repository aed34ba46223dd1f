"""Solution of a factor graph at the end of a run: all of it at once, with what single updates leave out."""

from __future__ import annotations

from gtsam.symbol_shorthand import L, X

from ..geometry.segments import Floats
from ..memory import return_freed_memory
from .array_graph import ArrayGraph
from .batch_solution import BatchSolution
from .factor_graph import Additions, FactorGraph
from .factors import Factor, FactorKind
from .gtsam_factors import from_pose2
from .range_bias import estimate_range_bias
from .wall_correlation import divisors_of_information, with_correlated_errors

# Gauss-Newton steps of a solution. Origin: numerical.
BATCH_STEPS = 3


def solve_with_range_bias(graph: FactorGraph, *, correlate: bool = False) -> None:
    """Estimate the range bias together with the graph, and solve everything again without it.

    The estimate has converged. If no observation depends on the range bias, none is estimated. If `correlate`, the
    information of walls whose errors repeat with every view is divided first. Doing it again changes little, as the
    residuals are those of the new factors.
    """
    solver = graph.solver
    factors, arrays = solver.sorted_factors(), solver.arrays()
    if correlate:
        divisors = _divisors_of_information(graph, factors)
        factors, arrays = with_correlated_errors(factors, divisors), arrays.with_divided_information(divisors)
    values = arrays.values_of(solver.estimate())
    solver.dismiss_isam()  # the batch solution takes its place, and needs memory too
    return_freed_memory()
    solver.range_bias = estimate_range_bias(arrays, values, solver.range_bias) or solver.range_bias
    _solve_at_once(graph, factors, arrays.at_bias(solver.range_bias.metres), values)


def _divisors_of_information(graph: FactorGraph, factors: list[Factor]) -> Floats:
    values = graph.solver.estimate()
    observations = [factor for factor in factors if factor.kind is FactorKind.WALL_HEADING]
    return divisors_of_information(
        factors,
        {k: from_pose2(values.atPose2(X(k))) for k in {factor.first for factor in observations}},
        {j: from_pose2(values.atPose2(L(j))) for j in {factor.second for factor in observations}},
        graph.solver.range_bias.metres,
    )


def _solve_at_once(graph: FactorGraph, factors: list[Factor], arrays: ArrayGraph, values: Floats) -> None:
    """Replace the solution of a graph by that of some Gauss-Newton steps from `values` (n, 3).

    `arrays` are the `factors` as arrays.
    """
    solver = graph.solver
    solution = BatchSolution(arrays, values, solver.range_bias.metres)
    for _ in range(BATCH_STEPS - 1):
        if solution.is_determined:
            solution = solution.again()
    if solution.is_determined:
        solver.replace_by_batch(factors, solution)
        return
    # undetermined in this form; the incremental solver may still manage with QR
    graph.additions = Additions(factors, arrays.to_values(solution.linearised))
    solver.reset()
    graph.update()

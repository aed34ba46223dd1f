"""The range bias, an error common to all ranges, estimated together with the graph.

It is one more unknown b of the least-squares problem, eliminated last. With all observations moved by their slopes
times a step of b, the linearised graph gives the estimate's response x' = dx/db. The least cost for a given b is a
parabola, whose vertex is the estimate and whose curvature is the information of b. The covariance of the other
variables with b unknown is theirs with b known, plus x' x'^T times the variance of b (Schur complement; Schmidt 1966).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C

from drivers.immutable import immutable

from ..errors import MapError
from ..geometry.segments import Floats
from .array_graph import ArrayGraph

# Metres by which the bias is moved for derivatives, first and near the estimate, where the weights of robust kernels
# must hardly change. Origin: numerical.
FIRST_STEP, BIAS_STEP = 5e-3, 1e-3
# Metres: standard deviation of the bias before the drive. Origin: data sheet of lidars for indoor use, which state an
# accuracy of 1 to 3 cm, two to three standard deviations of all systematic errors.
PRIOR_SIGMA = 0.01
# Maximum of parabolas: the robust weights follow the bias. Origin: numerical; on two recordings the estimate is within
# 0.3 and 0.8 standard deviations of its limit after the two estimates of a run.
MAX_PARABOLAS = 6
# Share of the standard deviation: the estimate has converged if a step changes it by less. Origin: numerical.
CONVERGED_SHARE = 0.2


@immutable
class RangeBias:
    """Estimate of the range bias.

    metres    positive if ranges are too long
    sigma     standard deviation, metres; NaN if it has not been estimated
    response  change of each variable, by its key, per metre of bias, in its own tangent space
    """

    metres: float = 0.0
    sigma: float = float("nan")
    response: Mapping[int, Floats] = field(default_factory=dict)

    def covariance(self, keys: Sequence[int]) -> Floats:
        """Return the part of the joint covariance (m, m) of variables that the uncertainty of the bias causes.

        If the bias has not been estimated, it is a zero (1, 1), which can be added to any other part.
        """
        if not self.response:
            return np.zeros((1, 1))
        parts = [self.response.get(key, np.zeros(2 if gtsam.Symbol(key).chr() == CORNER else 3)) for key in keys]
        stacked = self.sigma * np.concatenate(parts)
        return np.outer(stacked, stacked)


# Character of the keys of corners. Origin: definition.
CORNER = gtsam.Symbol(C(0)).chr()


@immutable
class _CostOfBias:
    """Cost of the graph along the line on which its solution follows a change of the bias.

    values    (n, 3) solution before the step
    bias      metres
    here      (n, 3) Gauss-Newton step with this bias
    response  (n, 3) change of the solution per metre of bias
    """

    graph: ArrayGraph
    values: Floats
    bias: float
    here: Floats
    response: Floats

    def values_at(self, change: float) -> Floats:
        """Return the solution (n, 3) if the bias changes by `change` metres."""
        return self.graph.retract(self.values, self.here + change * self.response)

    def at(self, change: float) -> float:
        """Return the cost without that of the bias itself."""
        return self.graph.cost(self.values_at(change), self.bias + change)

    def not_rising(self, change: float, least: float) -> float:
        """Return the change, halved until the cost does not rise or it is less than `least` metres.

        With robust kernels the cost is not convex: where it curves downwards, a parabola's vertex, whose curvature is
        then that of the prior alone, may be far beyond the reach of the linearisation.
        """
        before = self.at(0.0) + (self.bias / PRIOR_SIGMA) ** 2
        while abs(change) >= least and self.at(change) + ((self.bias + change) / PRIOR_SIGMA) ** 2 > before:
            change *= 0.5
        return change


def estimate_range_bias(graph: ArrayGraph, values: Floats, start: RangeBias) -> RangeBias | None:
    """Return the estimate of the range bias, given the graph and its solution `values` (n, 3) with `start`.

    Returns None if no factor depends on the bias, or if the linearised graph cannot be solved.
    """
    if not graph.depends_on_bias:
        return None
    step = FIRST_STEP if np.isnan(start.sigma) else BIAS_STEP
    bias, sigma, response = start.metres, PRIOR_SIGMA, np.zeros_like(values)
    for _ in range(MAX_PARABOLAS):
        try:
            here = graph.step(values, bias)
            response = (graph.step(values, bias + step) - here) / step
        except MapError:  # undetermined in this form; the incremental solver may still manage with QR
            return None
        costs = _CostOfBias(graph, values, bias, here, response)
        low, middle, high = costs.at(-step), costs.at(0.0), costs.at(step)
        curvature = max((low - 2.0 * middle + high) / step**2, 0.0) + 2.0 / PRIOR_SIGMA**2
        change = -((high - low) / (2.0 * step) + 2.0 * bias / PRIOR_SIGMA**2) / curvature
        sigma = float(np.sqrt(2.0 / curvature))
        change = costs.not_rising(change, CONVERGED_SHARE * sigma)
        bias, values = bias + change, costs.values_at(change)
        if step == BIAS_STEP and abs(change) < CONVERGED_SHARE * sigma:
            break
        step = BIAS_STEP
    return RangeBias(float(bias), sigma, graph.by_key(response))

"""The residuals of a graph's factors."""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np

from .factor_residuals import ALONG, CORNER, ODOMETRY, PRIOR, SAME_WALL, WALL, Residuals

_KINDS = {"xx": ODOMETRY, "xl": WALL, "xc": CORNER, "ll": SAME_WALL}


def residuals_of(
    factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, cauchy_scales: Mapping[str, float]
) -> Residuals:
    """Those of all factors that are there; what has been taken out leaves a gap in the graph.

    `cauchy_scales` of the kernels, by kind; the other kinds have none.
    """
    kinds: list[str] = []
    between: list[tuple[int, int]] = []
    squared: list[float] = []
    freedom: list[int] = []
    for factor in (factors.at(number) for number in range(factors.size())):
        if not isinstance(factor, gtsam.NoiseModelFactor):
            continue
        ends = [gtsam.Symbol(key) for key in list(factor.keys())]
        error = factor.whitenedError(values)
        kind = _KINDS.get("".join(chr(end.chr()) for end in ends), PRIOR)
        if kind == WALL and not isinstance(factor.noiseModel(), gtsam.noiseModel.Robust):
            kind = ALONG
        kinds.append(kind)
        between.append((ends[0].index(), ends[1].index() if len(ends) > 1 else -1))
        squared.append(float(error @ error))
        freedom.append(_freedom(kind, factor.dim()))
    pairs = np.array(between, dtype=np.int64).reshape(-1, 2)
    distance, scale = np.array(squared), np.array([cauchy_scales.get(kind, np.inf) for kind in kinds])
    weight = 1.0 / (1.0 + distance / scale**2)
    return Residuals(tuple(kinds), pairs, distance, np.array(freedom, dtype=np.int64), weight)


def _freedom(kind: str, dimension: int) -> int:
    """Of a wall a factor measures the offset or the heading; that two are one is both; ALONG is a third."""
    return {WALL: 1, SAME_WALL: 2, ALONG: 1}.get(kind, dimension)

"""Errors of wall observations that repeat with every view.

A real wall is bent, and has frames and recesses. Segments fitted to it from neighbouring keyframes err alike, so many
of them contain less information than as many independent ones. The information of a wall's observations is divided by
the long-run variance of their whitened residuals in the order of the keyframes (Newey, West 1987), which is one for
white noise as modelled. Residuals are weighted by the robust kernel, as they are in the estimate, and divided by what
this leaves of white noise.

Equations: docs/mathematics.md#errors-that-repeat.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from .factors import WALL_CAUCHY_SCALE, Factor, FactorKind, by_kind

# Keyframes over which the errors of one wall are taken as correlated. Origin: chosen, some 5 m of driving, after which
# another part of the wall is seen; the residuals of recordings are white beyond it.
MAX_LAG = 15
# Observations of a wall at which its own estimate has as much weight as that of all walls: the variance of the estimate
# from n values is 4/3 (J + 1) / n of its square, and walls are expected to differ by their mean. Origin: definition.
EQUAL_WEIGHT_COUNT = 4.0 / 3.0 * (MAX_LAG + 1)

# Variance of a standard normal variable times its robust weight 1 / (1 + z^2 / 8).
# Origin: chi-square, 1 dof, integrated with WALL_CAUCHY_SCALE.
WEIGHTED_VARIANCE = 0.593


def with_correlated_errors(factors: Sequence[Factor], divisors: Floats) -> list[Factor]:
    """Return factors with their information divided by numbers (f,), see `divisors_of_information`."""
    return [
        # `dataclasses.replace` would take three times as long
        f if divisor == 1.0 else Factor(f.kind, f.first, f.second, f.measured, f.covariance * divisor, f.bias_slope)
        for f, divisor in zip(factors, divisors.tolist(), strict=True)
    ]


def divisors_of_information(
    factors: Sequence[Factor], poses: Mapping[int, se2.Pose], frames: Mapping[int, se2.Pose], bias: float
) -> Floats:
    """Return (f,) the long-run variances of the residuals of walls, for each of their factors; one for other factors.

    factors  in their order
    poses    of the keyframes, [x, y, heading]
    frames   of the walls
    bias     range bias without which the graph was solved, metres

    Long-run variances below one are taken as one: estimating poses and walls has made residuals smaller than errors.
    """
    result = np.ones(len(factors))
    for kind in (FactorKind.WALL_HEADING, FactorKind.WALL_OFFSET):
        rows = [row for row, factor in enumerate(factors) if factor.kind is kind]
        if rows:
            chosen = [factors[row] for row in rows]
            influence = _weighted_residuals(chosen, poses, frames, bias)
            walls = np.array([factor.second for factor in chosen])
            variance = _variances_of_walls(walls, influence)
            result[rows] = [max(1.0, variance[wall]) for wall in walls.tolist()]
    return result


def _weighted_residuals(
    factors: list[Factor], poses: Mapping[int, se2.Pose], frames: Mapping[int, se2.Pose], bias: float
) -> Floats:
    """Return the whitened residuals (n,) of factors of one kind of wall observation, times their robust weights.

    Their variance is one for white noise as modelled.
    """
    whitened = whitened_residuals(factors, poses, frames, bias)
    weight = 1.0 / (1.0 + (whitened / WALL_CAUCHY_SCALE) ** 2)
    return np.asarray(weight * whitened / np.sqrt(WEIGHTED_VARIANCE))


def whitened_residuals(
    factors: Sequence[Factor], poses: Mapping[int, se2.Pose], frames: Mapping[int, se2.Pose], bias: float
) -> Floats:
    """Return the residuals (n,) of factors of one kind of wall observation, divided by their standard deviations.

    For `poses`, `frames` and `bias` see `divisors_of_information`.
    """
    observers, walls = _rows(poses, [f.first for f in factors]), _rows(frames, [f.second for f in factors])
    seen = se2.between(observers, walls)
    (group,) = by_kind(factors)
    measured = group.without_range_bias(bias)
    error = se2.between(measured[:, :3], seen).reshape(-1, 3)
    residual = error[:, 2] if measured.shape[1] == 3 else error[:, 1] + measured[:, 3] * error[:, 2]
    return np.asarray(residual / np.sqrt(group.covariances[:, 0, 0]))


def _rows(poses: Mapping[int, se2.Pose], numbers: list[int]) -> Floats:
    """Return the poses (n, 3) with some numbers (n,)."""
    known = sorted(poses)
    return np.array([poses[number] for number in known])[np.searchsorted(known, numbers)]


def _variances_of_walls(walls: np.ndarray[tuple[int], np.dtype[np.int64]], values: Floats) -> dict[int, float]:
    """Return the long-run variance of each wall's values (n,), shrunk to that of all walls."""
    sums = {int(wall): (long_run_sum(values[walls == wall]), int((walls == wall).sum())) for wall in np.unique(walls)}
    common = sum(total for total, _ in sums.values()) / len(values)
    return {
        wall: (total + EQUAL_WEIGHT_COUNT * common) / (count + EQUAL_WEIGHT_COUNT)
        for wall, (total, count) in sums.items()
    }


def long_run_sum(values: Floats) -> float:
    """Return n times the long-run variance of values (n,) in order."""
    lags = range(1, min(MAX_LAG, len(values) - 1) + 1)
    products = sum((1.0 - j / (MAX_LAG + 1)) * float(values[j:] @ values[:-j]) for j in lags)
    return float(values @ values) + 2.0 * products

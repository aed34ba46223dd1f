"""Errors of wall observations that repeat with every view.

A real wall is bent, and has frames and recesses. Segments fitted to it from neighbouring keyframes err alike, so many
of them contain less information than as many independent ones. The information of a wall's observations is divided by
the long-run variance of their whitened errors in the order of the keyframes (Newey, West 1987), which is one for white
noise as modelled. Only residuals are known: poses and walls were estimated from the same observations and have absorbed
a part of the errors, about half of the offsets in recordings. So the sum of the products of residuals is divided by
what it would be for white errors. Residuals are weighted by the robust kernel, as they are in the estimate, and divided
by what that leaves of white noise.

Equations: docs/mathematics.md#errors-that-repeat.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from .factors import OBSERVATION_KINDS, WALL_CAUCHY_SCALE, Factor, FactorKind, FactorsOfKind, by_kind

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
    """Return (f,) the long-run variances of the errors of walls, for each of their factors; one for other factors.

    factors  in their order
    poses    of the keyframes, [x, y, heading]
    frames   of the walls
    bias     range bias without which the graph was solved, metres

    Long-run variances below one are taken as one: single observations are not better than modelled.
    """
    result = np.ones(len(factors))
    groups = []
    for kind in OBSERVATION_KINDS:
        rows = [row for row, factor in enumerate(factors) if factor.kind is kind]
        if rows:
            groups.append((rows, _observations([factors[row] for row in rows], poses, frames, bias)))
    if not groups:
        return result
    covariance_of_poses = _covariances((group.keyframes, group.pose_jacobian) for _, group in groups)
    covariance_of_walls = _covariances((group.walls, group.wall_jacobian) for _, group in groups)
    for rows, group in groups:
        pose_covariances = covariance_of_poses[group.keyframes]
        leverage = np.einsum("ni,nij,nj->n", group.pose_jacobian, pose_covariances, group.pose_jacobian)
        variances = np.maximum(0.0, 1.0 - leverage)
        roots = np.linalg.cholesky(covariance_of_walls)[group.walls]
        hat_roots = np.sqrt(variances)[:, None] * np.einsum("ni,nij->nj", group.wall_jacobian, roots)
        result[rows] = np.maximum(1.0, _variances_of_walls(group.walls, group.values, variances, hat_roots))
    return result


@immutable
class _Observations:
    """n observations of walls, by one kind of factor, at the solution of the graph.

    keyframes, walls  (n,) rows of the poses and of the walls
    values   (n,) whitened residuals times their robust weights; their errors have variance one as modelled
    pose_jacobian  (n, 3) of the whitened residuals by the pose of the keyframe, in its own frame, times the roots of
                   the robust weights
    wall_jacobian  (n, 2) the same by offset and heading of the wall, in its own frame
    """

    keyframes: Integers
    walls: Integers
    values: Floats
    pose_jacobian: Floats
    wall_jacobian: Floats


def _observations(
    factors: list[Factor], poses: Mapping[int, se2.Pose], frames: Mapping[int, se2.Pose], bias: float
) -> _Observations:
    """Return the factors of one kind of wall observation as arrays; arguments as of `divisors_of_information`."""
    whitened = whitened_residuals(factors, poses, frames, bias)
    weight = 1.0 / (1.0 + (whitened / WALL_CAUCHY_SCALE) ** 2)
    (group,) = by_kind(factors)
    keyframes, walls = (_rows(known, numbers) for known, numbers in zip((poses, frames), group.numbers.T, strict=True))
    x, y, heading = _seen(group, poses, frames).T
    sine, cosine, zero, one = np.sin(heading), np.cos(heading), np.zeros_like(x), np.ones_like(x)
    pose_jacobian, wall_jacobian = np.stack([zero, zero, -one], axis=1), np.stack([zero, one], axis=1)
    if group.kind is FactorKind.WALL_OFFSET:
        lever = group.measured[:, 3]
        pose_jacobian = np.stack([sine, -cosine, -(x * cosine + y * sine + lever)], axis=1)
        wall_jacobian = np.stack([one, lever], axis=1)
    scale = np.sqrt(weight / group.covariances[:, 0, 0])[:, None]
    values = weight * whitened / np.sqrt(WEIGHTED_VARIANCE)
    return _Observations(keyframes, walls, values, scale * pose_jacobian, scale * wall_jacobian)


def _covariances(jacobians: Iterable[tuple[Integers, Floats]]) -> Floats:
    """Return (k, d, d) the covariances of k variables by observations alone, all other variables being known.

    jacobians  for each kind of observation, rows (n,) of the variables and Jacobian (n, d) of the whitened residuals

    Without observations, a variable is known to a metre and a radian.
    """
    rows, jacobian = (np.concatenate(parts) for parts in zip(*jacobians, strict=True))
    information = np.zeros((int(rows.max()) + 1, jacobian.shape[1], jacobian.shape[1]))
    np.add.at(information, rows, jacobian[:, :, None] * jacobian[:, None, :])
    return np.asarray(np.linalg.inv(information + np.eye(jacobian.shape[1])))


def whitened_residuals(
    factors: Sequence[Factor], poses: Mapping[int, se2.Pose], frames: Mapping[int, se2.Pose], bias: float
) -> Floats:
    """Return the residuals (n,) of factors of one kind of wall observation, divided by their standard deviations.

    For `poses`, `frames` and `bias` see `divisors_of_information`.
    """
    (group,) = by_kind(factors)
    measured = group.without_range_bias(bias)
    error = se2.between(measured[:, :3], _seen(group, poses, frames)).reshape(-1, 3)
    residual = error[:, 2] if measured.shape[1] == 3 else error[:, 1] + measured[:, 3] * error[:, 2]
    return np.asarray(residual / np.sqrt(group.covariances[:, 0, 0]))


def _seen(group: FactorsOfKind, poses: Mapping[int, se2.Pose], frames: Mapping[int, se2.Pose]) -> Floats:
    """Return the frames (n, 3) of the walls of n observations in those of the keyframes."""
    observers, walls = (
        np.array([known[number] for number in sorted(known)])[_rows(known, numbers)]
        for known, numbers in zip((poses, frames), group.numbers.T, strict=True)
    )
    return np.asarray(se2.between(observers, walls)).reshape(-1, 3)


def _rows(poses: Mapping[int, se2.Pose], numbers: Integers) -> Integers:
    """Return the rows (n,) of the poses with some numbers in the order of all numbers."""
    return np.searchsorted(sorted(poses), numbers)


def _variances_of_walls(walls: Integers, values: Floats, variances: Floats, hat_roots: Floats) -> Floats:
    """Return (n,) the long-run variance of the errors of each observation's wall, shrunk to that of all walls.

    walls      (n,) of the observations
    values     (n,) weighted residuals
    variances  (n,) of residuals of white errors, if only the poses were estimated: one minus the leverage
    hat_roots  (n, 2) rows of B: estimating the walls, too, subtracts the hat matrix B B' of each wall
    """
    order = np.argsort(walls, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(walls[order])) + 1)
    sums = np.array([long_run_sum(values[group]) for group in groups])
    # sums of residuals of white errors of variance one
    expected = np.array(
        [variances[group].sum() - sum(long_run_sum(column) for column in hat_roots[group].T) for group in groups]
    )
    common = (sums.sum() + EQUAL_WEIGHT_COUNT) / (expected.sum() + EQUAL_WEIGHT_COUNT)  # one before observations
    long_run = (sums + EQUAL_WEIGHT_COUNT * common) / (expected + EQUAL_WEIGHT_COUNT)
    result = np.empty(len(walls))
    result[order] = np.repeat(long_run, [len(group) for group in groups])
    return result


def long_run_sum(values: Floats) -> float:
    """Return n times the long-run variance of values (n,) in order."""
    lags = range(1, min(MAX_LAG, len(values) - 1) + 1)
    products = sum((1.0 - j / (MAX_LAG + 1)) * float(values[j:] @ values[:-j]) for j in lags)
    return float(values @ values) + 2.0 * products

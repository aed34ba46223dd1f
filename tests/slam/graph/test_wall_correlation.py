"""Observations of walls whose errors repeat with every view."""

import numpy as np
import pytest

from drivers import se2
from slam.graph.factors import Factor, FactorKind
from slam.graph.wall_correlation import (
    _observations,
    divisors_of_information,
    whitened_residuals,
    with_correlated_errors,
)

SIGMA = 0.002
KINDS = (FactorKind.WALL_HEADING, FactorKind.WALL_OFFSET)


def inflation(kind: FactorKind, errors: np.ndarray) -> np.ndarray:
    """Return the factors by which the variances of observations with errors (w, n) of w walls are multiplied.

    The walls are parallel and all are seen from n keyframes, so the solution takes the mean error of each keyframe and
    of each wall for theirs.
    """
    walls, count = errors.shape
    residuals = errors - errors.mean(axis=0) - errors.mean(axis=1, keepdims=True) + errors.mean()
    factors, poses = [], {k: np.zeros(3) for k in range(count)}
    for wall in range(walls):
        for k in range(count):
            error = residuals[wall, k]
            measured = [1.0, 0.0, error] if kind is FactorKind.WALL_HEADING else [1.0, error, 0.0, 0.3]
            factors.append(Factor(kind, k, wall, np.array(measured), np.array([[SIGMA**2]]), np.zeros(1)))
    frames = {wall: np.array([1.0, 0.0, 0.0]) for wall in range(walls)}
    result = with_correlated_errors(factors, divisors_of_information(factors, poses, frames, 0.0))
    return np.array([factor.covariance[0, 0] for factor in result]).reshape(walls, count)[:, 0] / SIGMA**2


def autoregressive(random: np.random.Generator, walls: int, count: int, decay: float) -> np.ndarray:
    """Return errors (w, n) of variance SIGMA^2 whose correlation decays by a factor from one to the next."""
    errors = random.normal(0.0, SIGMA, (walls, count))
    for k in range(1, count):
        errors[:, k] = decay * errors[:, k - 1] + np.sqrt(1.0 - decay**2) * errors[:, k]
    return errors


@pytest.mark.parametrize("kind", KINDS)
def test_white_errors_keep_their_information(kind: FactorKind) -> None:
    scales = inflation(kind, np.random.default_rng(1).normal(0.0, SIGMA, (30, 60)))
    assert scales.min() == 1.0
    assert scales.mean() < 1.2


@pytest.mark.parametrize("kind", KINDS)
def test_repeated_errors_lose_information(kind: FactorKind) -> None:
    """With a decay of 0.6 the mean of many has (1 + 0.6) / (1 - 0.6) = 4 times the variance of white errors."""
    random = np.random.default_rng(2)
    scales = inflation(kind, autoregressive(random, 30, 200, 0.6))
    assert scales.mean() == pytest.approx(4.0, rel=0.3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("walls", "views"),
    [(2, 60), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((3, 60), (8, 60), (20, 30)))],
)
@pytest.mark.parametrize(("decay", "variance", "tolerance"), [(0.0, 1.0, 0.4), (0.6, 4.0, 0.3)])
def test_errors_that_poses_and_walls_have_absorbed_count(
    kind: FactorKind, walls: int, views: int, decay: float, variance: float, tolerance: float
) -> None:
    """A pose takes half of the variance of two walls' errors, and a wall most of what is common to few views.

    Estimates below one are taken as one, which makes the mean for white errors larger.
    """
    random = np.random.default_rng(4)
    scales = [inflation(kind, autoregressive(random, walls, views, decay)).mean() for _ in range(50)]
    assert np.mean(scales) == pytest.approx(variance, rel=tolerance)


def test_walls_differ() -> None:
    """Walls with white errors beside walls with repeated ones keep most of their information."""
    random = np.random.default_rng(3)
    errors = np.vstack([autoregressive(random, 10, 300, 0.6), random.normal(0.0, SIGMA, (10, 300))])
    scales = inflation(FactorKind.WALL_HEADING, errors)
    assert scales[:10].mean() > 2.0 * scales[10:].mean()


@pytest.mark.parametrize("kind", KINDS)
def test_jacobians_are_those_of_the_residuals(kind: FactorKind) -> None:
    pose, wall = np.array([2.0, -1.0, 0.7]), np.array([3.0, 2.5, -1.1])
    measured = se2.between(pose, wall)
    if kind is FactorKind.WALL_OFFSET:
        measured = np.append(measured, 0.4)
    factor = Factor(kind, 5, 9, measured, np.array([[SIGMA**2]]), np.zeros(1))

    def residual(by_pose: np.ndarray, by_wall: np.ndarray) -> float:
        poses, frames = {5: se2.compose(pose, by_pose)}, {9: se2.compose(wall, by_wall)}
        return float(whitened_residuals([factor], poses, frames, 0.0)[0])

    step, still = 1e-6, np.zeros(3)
    by_pose = [residual(step * axis, still) / step for axis in np.eye(3)]
    by_wall = [residual(still, step * axis) / step for axis in np.eye(3)[1:]]  # offset and heading
    found = _observations([factor], {5: pose}, {9: wall}, 0.0)
    np.testing.assert_allclose(found.pose_jacobian[0], by_pose, atol=1e-2)
    np.testing.assert_allclose(found.wall_jacobian[0], by_wall, atol=1e-2)

"""Observations of walls whose errors repeat with every view."""

import numpy as np
import pytest

from slam.graph.factors import Factor, FactorKind
from slam.graph.wall_correlation import divisors_of_information, with_correlated_errors

SIGMA = 0.002


def inflation(kind: FactorKind, errors: np.ndarray) -> np.ndarray:
    """Return the factors by which the variances of observations with errors (w, n) of w walls are multiplied."""
    walls, count = errors.shape
    factors, poses = [], {k: np.zeros(3) for k in range(count)}
    for wall in range(walls):
        for k in range(count):
            error = errors[wall, k]
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


@pytest.mark.parametrize("kind", [FactorKind.WALL_HEADING, FactorKind.WALL_OFFSET])
def test_white_errors_keep_their_information(kind: FactorKind) -> None:
    scales = inflation(kind, np.random.default_rng(1).normal(0.0, SIGMA, (30, 60)))
    assert scales.min() == 1.0
    assert scales.mean() < 1.2


@pytest.mark.parametrize("kind", [FactorKind.WALL_HEADING, FactorKind.WALL_OFFSET])
def test_repeated_errors_lose_information(kind: FactorKind) -> None:
    """With a decay of 0.6 the mean of many has (1 + 0.6) / (1 - 0.6) = 4 times the variance of white errors."""
    random = np.random.default_rng(2)
    scales = inflation(kind, autoregressive(random, 30, 200, 0.6))
    assert scales.mean() == pytest.approx(4.0, rel=0.3)


def test_walls_differ() -> None:
    """Walls with white errors beside walls with repeated ones keep most of their information."""
    random = np.random.default_rng(3)
    errors = np.vstack([autoregressive(random, 10, 300, 0.6), random.normal(0.0, SIGMA, (10, 300))])
    scales = inflation(FactorKind.WALL_HEADING, errors)
    assert scales[:10].mean() > 2.0 * scales[10:].mean()

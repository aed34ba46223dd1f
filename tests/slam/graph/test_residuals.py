"""Residuals of factors, and what is expected of them."""

import numpy as np
import pytest

from slam.graph.residuals import ODOMETRY, WALL, Residuals


def residuals(kind: str, between: np.ndarray, squared: np.ndarray) -> Residuals:
    count = len(between)
    return Residuals((kind,) * count, between, squared, np.ones(count, dtype=np.int64), np.ones(count))


def test_the_expected_variance_of_walls_is_that_of_a_least_squares_fit() -> None:
    """30 poses and 8 walls are fitted to white noise in two observations of each wall from each pose."""
    random = np.random.default_rng(0)
    between = np.repeat(np.indices((30, 8)).reshape(2, -1).T, 2, axis=0)
    rows, jacobian = np.arange(len(between)), np.zeros((len(between), 3 * 30 + 2 * 8))
    for column in range(3):
        jacobian[rows, 3 * between[:, 0] + column] = random.standard_normal(len(between))
    for column in range(2):
        jacobian[rows, 3 * 30 + 2 * between[:, 1] + column] = random.standard_normal(len(between))
    noise = random.standard_normal((len(between), 50))
    left = noise - jacobian @ np.linalg.lstsq(jacobian, noise, rcond=None)[0]
    expected = residuals(WALL, between, left[:, 0] ** 2).expected_wall_variance()
    assert expected == pytest.approx(np.mean(left**2), rel=0.03)
    assert expected < 0.85


def test_the_expected_variance_is_positive_whatever_was_observed() -> None:
    seen_once = residuals(WALL, np.array([[0, 0], [0, 0]]), np.zeros(2))
    nothing = residuals(ODOMETRY, np.array([[0, 1]]), np.zeros(1))
    assert seen_once.expected_wall_variance() > 0.0
    assert nothing.expected_wall_variance() == 1.0

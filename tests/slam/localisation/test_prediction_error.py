"""Learned error of the poses that odometry predicts."""

from __future__ import annotations

import numpy as np
import pytest

from slam.geometry.segments import Floats
from slam.localisation.prediction_error import PREDICTION_SIGMAS, PredictionError

MATCH = np.diag(np.full(3, 0.001**2))


def learn(error: PredictionError, sigmas: Floats, count: int, seed: int, *, gross: float = 0.0) -> None:
    """Add scans whose predictions err by `sigmas` (3,), and a share `gross` of them by a metre more."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        difference = sigmas * random.standard_normal(3) + (random.random() < gross)
        error.add(difference, np.diag(error.variances + 0.002**2), MATCH)


@pytest.mark.parametrize("scale", [0.2, 1.0, 4.0])
def test_the_error_is_learned_within_two_hundred_scans(scale: float) -> None:
    sigmas, learned = scale * PREDICTION_SIGMAS, []
    for seed in range(30):
        error = PredictionError()
        learn(error, sigmas, 200, seed)
        learned.append(np.sqrt(error.variances))
    np.testing.assert_allclose(np.median(learned, axis=0), sigmas, rtol=0.2)
    np.testing.assert_allclose(learned, np.broadcast_to(sigmas, (30, 3)), rtol=0.6)


def test_gross_errors_do_not_matter() -> None:
    error = PredictionError()
    learn(error, PREDICTION_SIGMAS, 400, 1, gross=0.1)
    assert np.all(error.variances < (2.0 * PREDICTION_SIGMAS) ** 2)


def test_scans_that_do_not_determine_their_pose_say_nothing() -> None:
    error = PredictionError()
    error.add(np.array([0.0, 0.5, 0.0]), error.covariance, np.diag([0.001, 0.5, 0.001]) ** 2)
    np.testing.assert_array_equal(error.variances, PREDICTION_SIGMAS**2)
    assert error.scans == 0


def test_variances_stay_above_what_can_be_told_from_the_rest() -> None:
    error = PredictionError()
    for _ in range(1000):
        error.add(np.zeros(3), np.diag(error.variances + 0.01**2), MATCH)
    assert np.all(np.sqrt(error.variances) > 0.003)
    assert np.all(np.sqrt(error.variances) < 0.006)

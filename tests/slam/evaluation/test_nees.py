import numpy as np
import pytest

from drivers import se2
from slam.errors import MapError
from slam.evaluation.nees import (
    consistency,
    line_nees,
    nees,
    point_nees,
    pose_nees,
    run_consistency,
)


def draw(dimensions: int, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and the covariances from which they were drawn."""
    generator = np.random.default_rng(seed)
    factors = 0.02 * generator.normal(size=(count, dimensions, dimensions))
    covariances = factors @ factors.transpose(0, 2, 1) + 1e-5 * np.eye(dimensions)
    errors = np.stack([generator.multivariate_normal(np.zeros(dimensions), c) for c in covariances])
    return errors, covariances


def test_correct_pose_covariances_are_consistent_and_scaled_ones_are_not() -> None:
    errors, covariances = draw(3, 400, seed=1)
    estimates = np.random.default_rng(2).uniform(-3, 3, (400, 3))
    truth = se2.compose(estimates, errors)
    assert consistency(pose_nees(estimates, covariances, truth), 3).consistent
    assert consistency(pose_nees(estimates, covariances / 4, truth), 3).mean == pytest.approx(12, rel=0.15)
    assert not consistency(pose_nees(estimates, covariances / 2, truth), 3).consistent
    assert not consistency(pose_nees(estimates, covariances * 2, truth), 3).consistent


def test_correct_point_covariances_are_consistent() -> None:
    errors, covariances = draw(2, 400, seed=3)
    truth = np.random.default_rng(4).uniform(-3, 3, (400, 2))
    assert consistency(point_nees(truth - errors, covariances, truth), 2).consistent


def test_the_nees_of_walls_is_independent_of_the_true_frames_position_along_the_wall() -> None:
    errors, covariances = draw(2, 400, seed=5)
    errors, covariances = 0.1 * errors, 0.01 * covariances
    frames = np.random.default_rng(6).uniform(-3, 3, (400, 3))
    wall = se2.compose(frames, np.column_stack([np.zeros(400), errors]))
    along = np.column_stack([np.linspace(-9, 9, 400), np.zeros((400, 2))])
    expected = nees(errors, covariances)
    np.testing.assert_allclose(line_nees(frames, covariances, wall), expected)
    np.testing.assert_allclose(line_nees(frames, covariances, se2.compose(wall, along)), expected, rtol=1e-6)


@pytest.mark.slow
def test_the_band_of_runs_holds_for_correlated_values_within_runs() -> None:
    """Errors of a run have a common part; counted singly they would leave their narrow band far too often."""
    random, kept, narrow = np.random.default_rng(8), 0, 0
    for _ in range(200):
        shared = random.normal(size=(30, 1, 2))
        errors = np.sqrt(0.7) * shared + np.sqrt(0.3) * random.normal(size=(30, 25, 2))
        runs = list((errors**2).sum(axis=-1))
        found = run_consistency([np.append(run, np.nan) for run in runs] + [np.array([np.nan])], 2)
        assert found.count == 30
        kept += found.consistent
        narrow += consistency(np.concatenate(runs), 2).consistent
    assert kept > 0.93 * 200
    assert narrow < 0.6 * 200


def test_the_standard_error_is_that_of_the_mean() -> None:
    assert consistency(np.array([1.0, 3.0]), 3).standard_error == pytest.approx(1.0)
    assert np.isnan(consistency(np.array([1.0]), 3).standard_error)


def test_singular_covariances_and_empty_sets_raise_an_error() -> None:
    with pytest.raises(MapError, match="singular"):
        nees(np.ones((1, 2)), np.zeros((1, 2, 2)))
    with pytest.raises(MapError, match="no NEES value"):
        consistency(np.array([]), 3)

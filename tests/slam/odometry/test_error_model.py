"""Error model of odometry: learning of random and systematic errors, correlated drift, and fusion with points."""

import numpy as np
import pytest

from drivers import se2
from slam.config import OdometryConfig
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import wheel_travel

DETERMINED = np.diag([1e6, 1e6, 1e6])  # information of a registration in all directions
CORRIDOR = np.diag([0.0, 1e6, 1e6])  # information of a registration along a corridor: none ahead


@pytest.mark.parametrize(("translation", "rotation"), [(0.05, 0.03), (0.2, 0.1)])
def test_random_errors_are_learned_despite_gross_errors(translation: float, rotation: float) -> None:
    random, model = np.random.default_rng(0), OdometryModel(OdometryConfig())
    for k in range(400):
        measured = np.array([random.uniform(0.1, 0.5), 0.0, random.uniform(-0.2, 0.2)])
        travel = wheel_travel(measured)
        error = random.normal(size=3) * [translation * travel, translation * travel, rotation * np.sqrt(travel)]
        if k % 10 == 0:
            error += [0.5, 0.0, 0.5]
        model.add_motion(measured, se2.compose(measured, error), DETERMINED)
    assert model.deviations == pytest.approx([translation, rotation], rel=0.4)


def test_nothing_is_learned_if_so_configured_or_while_the_robot_stands() -> None:
    measured, registered = np.array([1.0, 0.0, 0.0]), np.array([1.5, 0.0, 0.5])
    fixed = OdometryModel(OdometryConfig(learn=False))
    before = fixed.deviations.copy()
    fixed.add_motion(measured, registered, DETERMINED)
    np.testing.assert_array_equal(fixed.deviations, before)
    model = OdometryModel(OdometryConfig())
    model.add_motion(0.01 * measured, registered, DETERMINED)
    np.testing.assert_array_equal(model.deviations, before)
    assert np.linalg.eigvalsh(model.covariance(np.zeros(3))).min() > 0


def test_nothing_is_learned_along_a_corridor() -> None:
    random, model = np.random.default_rng(0), OdometryModel(OdometryConfig(translation_error=0.1))
    measured = np.array([0.3, 0.0, 0.0])
    for _ in range(200):
        error = [0.0, random.normal(0, 1e-3), random.normal(0, 0.01)]
        model.add_motion(measured, se2.compose(measured, error), CORRIDOR)
    assert model.deviations == pytest.approx(OdometryModel(OdometryConfig(translation_error=0.1)).deviations)


def test_systematic_errors_are_learned_and_corrected() -> None:
    random, model = np.random.default_rng(0), OdometryModel(OdometryConfig())
    length, turning, veer = 0.96, 1.1, 0.05
    for k in range(400):
        measured = np.array([random.uniform(0.2, 0.4), 0.0, random.choice([0.0, random.uniform(-0.4, 0.4)])])
        turn = turning * measured[2] + veer * measured[0]
        bend = 0.5 * (turn - measured[2])
        actual = np.array([length * measured[0] * np.cos(bend), length * measured[0] * np.sin(bend), turn])
        gross = [0.5, 0.0, 0.5] if k % 10 == 0 else [0.0, 0.0, 0.0]
        registered = se2.compose(actual, random.normal(0, [3e-3, 3e-3, 5e-3]) + gross)
        model.add_motion(measured, registered, DETERMINED)
    assert model.systematic_errors == pytest.approx([length, turning, veer], abs=0.01)
    np.testing.assert_allclose(model.correct(measured), actual, atol=0.01)
    assert model.deviations[0] < 0.02  # without the systematic part
    restored = OdometryModel(OdometryConfig())
    restored.add_samples(model.samples)
    np.testing.assert_array_equal(restored.systematic_errors, model.systematic_errors)


def test_the_first_motions_say_little_about_systematic_errors() -> None:
    model = OdometryModel(OdometryConfig())
    for _ in range(2):
        measured = np.array([0.3, 0.0, 0.0])
        model.add_motion(measured, np.array([0.33, 0.0, 0.0]), DETERMINED)
    assert 1.0 < model.systematic_errors[0] < 1.02  # both motions seem to be a tenth too short


def test_the_noise_of_registration_is_not_that_of_odometry() -> None:
    random, sigma = np.random.default_rng(0), np.array([0.02, 0.02, 0.01])
    noisy, exact = OdometryModel(OdometryConfig()), OdometryModel(OdometryConfig())
    for _ in range(400):
        measured = np.array([random.uniform(0.2, 0.4), 0.0, random.uniform(-0.2, 0.2)])
        actual = se2.compose(measured, random.normal(size=3) * 0.05 * measured[0])
        exact.add_motion(measured, actual, DETERMINED)
        noisy.add_motion(measured, se2.compose(actual, random.normal(size=3) * sigma), np.diag(sigma**-2.0))
    np.testing.assert_allclose(noisy.deviations, exact.deviations, rtol=0.3)


def test_drift_is_correlated_only_in_undetermined_directions() -> None:
    model, step = OdometryModel(OdometryConfig(translation_error=0.1)), np.array([0.3, 0.0, 0.0])
    assert not model.correlated_drift(step, DETERMINED).any()
    correlated_drift = model.correlated_drift(step, CORRIDOR)
    np.testing.assert_allclose(correlated_drift[1:], 0.0, atol=1e-3 * correlated_drift[0, 0])
    steps = 50  # 15 metres; wheels that are a tenth too large err by 1.5 metres
    assert np.sqrt(steps * correlated_drift[0, 0]) > 1.5 > 5 * np.sqrt(steps * model.covariance(step)[0, 0])

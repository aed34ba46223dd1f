"""Error model of odometry: learning of random and systematic errors, correlated drift, and fusion with points."""

import numpy as np
import pytest

from drivers import se2
from slam.config import OdometryConfig
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import wheel_travel
from slam.odometry.systematic_errors import SYSTEMATIC_SIGMAS, SystematicErrors


def arc(length: float, turn: float) -> se2.Pose:
    """Return the motion along an arc."""
    chord = length * np.sinc(turn / (2 * np.pi))
    return np.array([chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn])


DETERMINED = np.diag([1e6, 1e6, 1e6])  # information of a registration in all directions
CORRIDOR = np.diag([0.0, 1e6, 1e6])  # information of a registration along a corridor: none ahead


@pytest.mark.parametrize(
    ("along", "across", "rotation", "turning"),
    [(0.08, 0.04, 0.03, 0.05), (0.2, 0.2, 0.1, 0.2), (0.05, 0.1, 0.05, 0.03)],
)
def test_random_errors_are_learned_despite_gross_errors(
    along: float, across: float, rotation: float, turning: float
) -> None:
    random, model = np.random.default_rng(0), OdometryModel(OdometryConfig())
    for k in range(400):
        measured = np.array([random.uniform(0.1, 0.5), 0.0, random.choice([0.0, random.uniform(-0.4, 0.4)])])
        travel = wheel_travel(measured)
        of_heading = np.hypot(rotation * np.sqrt(travel), turning * np.sqrt(abs(measured[2])))
        of_reading = model.floors[[0, 0, 1]]
        sigmas = np.hypot([along * travel, across * travel, of_heading], of_reading)
        gross = [0.5, 0.0, 0.5] if k % 10 == 0 else [0.0, 0.0, 0.0]
        model.add_motion(measured, se2.compose(measured, random.normal(size=3) * sigmas + gross), DETERMINED)
    assert model.deviations == pytest.approx([along, across, rotation, turning], rel=0.4)


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
    """Drive with worn wheels and a lidar whose mount was measured badly; one motion in ten has a gross error."""
    random, model = np.random.default_rng(0), OdometryModel(OdometryConfig())
    length, turning, veer, frame = 0.96, 1.1, 0.05, np.array([-0.08, 0.03, 0.02])
    for k in range(400):
        measured = np.array([random.uniform(0.2, 0.4), 0.0, random.choice([0.0, random.uniform(-0.4, 0.4)])])
        turn = turning * measured[2] + veer * measured[0]
        bend = 0.5 * (turn - measured[2])
        moved = np.array([length * measured[0] * np.cos(bend), length * measured[0] * np.sin(bend), turn])
        actual = se2.compose(frame, se2.compose(moved, se2.inverse(frame)))
        gross = [0.5, 0.0, 0.5] if k % 10 == 0 else [0.0, 0.0, 0.0]
        registered = se2.compose(actual, random.normal(0, [3e-3, 3e-3, 5e-3]) + gross)
        model.add_motion(measured, registered, DETERMINED)
    errors = model.systematic_errors
    assert errors.values == pytest.approx([length, turning, veer, *frame], abs=0.01)
    # A median deviates more than a mean, and one motion in ten is wrong.
    assert np.all(np.abs(errors.values - [length, turning, veer, *frame]) < 4.0 * np.sqrt(errors.variances))
    np.testing.assert_allclose(model.correct(measured), actual, atol=0.01)
    assert model.deviations[:2].max() < 0.03  # without the systematic part
    restored = OdometryModel(OdometryConfig())
    restored.add_samples(model.samples)
    np.testing.assert_array_equal(restored.systematic_errors.values, errors.values)


@pytest.mark.parametrize("share_of_turns", [0.0, 0.3])
@pytest.mark.parametrize("factor", [1.0, 1.1])
def test_wheels_that_slip_on_straight_drives_do_not_change_the_factor_of_turning(
    share_of_turns: float, factor: float
) -> None:
    """Measure turns of some degrees on straight drives, where the registered ones are zero.

    Slips in turns make the factor, which predicts the turn from the measured one, smaller by their share of its square.
    """
    random, model, slip, turning = np.random.default_rng(0), OdometryModel(OdometryConfig()), 0.1, 0.05
    for _ in range(400):
        turn = random.choice([-1, 1]) * random.uniform(0.2, 0.5) if random.uniform() < share_of_turns else 0.0
        travel = random.uniform(0.2, 0.5)
        error = np.hypot(slip * np.sqrt(travel), turning * np.sqrt(abs(turn))) * random.normal()
        registered = arc(travel, turn) + random.normal(0, [3e-3, 3e-3, 3e-3])
        model.add_motion(arc(travel, turn / factor + error), registered, np.diag([1e5, 1e5, 1e5]))
    errors = model.systematic_errors
    expected = factor if share_of_turns else 1.0
    of_slips = (slip**2 * 0.35 + turning**2 * 0.35) / (0.35 / factor) ** 2 if share_of_turns else 0.0
    sigma = np.sqrt(errors.variances[1])
    assert -3.0 * sigma - of_slips * factor < errors.turning - expected < 3.0 * sigma
    assert model.deviations[2] == pytest.approx(slip, rel=0.3)


def test_turns_that_are_measured_in_the_next_motion_do_not_change_the_factor_of_turning() -> None:
    """Of five motions on a bend four are measured a tenth too small, and the last one as much larger."""
    random, model = np.random.default_rng(0), OdometryModel(OdometryConfig())
    for k in range(300):
        turn = 0.3 * (-1.0) ** (k // 5)
        measured = 1.4 * turn if k % 5 == 4 else 0.9 * turn
        registered = arc(0.2, turn) + random.normal(0, [3e-3, 3e-3, 3e-3])
        model.add_motion(arc(0.2, measured), registered, DETERMINED)
    assert model.systematic_errors.turning == pytest.approx(1.0, abs=0.02)


def test_corrected_motions_add_up() -> None:
    """Correct a motion in one piece and in two: arcs of the same curvature."""
    errors = SystematicErrors(0.97, 1.0, 0.0, np.array([-0.1, 0.04, 0.03]), np.zeros(6))
    first, second = arc(0.3, 0.2), arc(0.6, 0.4)
    whole = errors.correct(se2.compose(first, second))
    np.testing.assert_allclose(se2.compose(errors.correct(first), errors.correct(second)), whole, atol=1e-9)


def test_the_first_motions_say_little_about_systematic_errors() -> None:
    model = OdometryModel(OdometryConfig())
    for _ in range(2):
        measured = np.array([0.3, 0.0, 0.0])
        model.add_motion(measured, np.array([0.33, 0.0, 0.0]), DETERMINED)
    assert 1.0 < model.systematic_errors.length < 1.02  # both motions seem to be a tenth too short


def test_another_drive_begins_with_the_errors_of_the_one_before_and_corrects_them_soon() -> None:
    random, model = np.random.default_rng(0), OdometryModel(OdometryConfig())

    def drive(length: float, motions: int) -> None:
        for _ in range(motions):
            measured = np.array([random.uniform(0.2, 0.4), 0.0, 0.0])
            model.add_motion(
                measured, np.array([(length + random.normal(0.0, 0.03)) * measured[0], 0.0, 0.0]), DETERMINED
            )

    drive(1.06, 500)
    before = model.systematic_errors
    model.begin_drive()
    begun = model.systematic_errors
    assert begun.values == pytest.approx(before.values)
    assert np.sqrt(begun.variances) == pytest.approx(SYSTEMATIC_SIGMAS)
    assert before.variances[0] < 0.1 * begun.variances[0]
    drive(0.98, 40)
    assert abs(model.systematic_errors.length - 0.98) < 3.0 * np.sqrt(model.systematic_errors.variances[0])
    restored = OdometryModel(OdometryConfig())
    restored.restore(model.samples, model.expected_errors)
    np.testing.assert_array_equal(restored.systematic_errors.values, model.systematic_errors.values)


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

"""Covariances of motions by odometry along paths with turns."""

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import Floats
from slam.odometry.history import QUARTER_TURN
from slam.odometry.path_errors import corrected_path, path_covariance
from slam.odometry.systematic_errors import PERFECT

from .arcs import LEFT_AND_RIGHT, driven, twists_of

SAMPLES = 4000
EXACT = np.zeros(4), np.zeros(2), np.zeros(6)  # rates, floors and variances of systematic errors
RATES, FLOORS = np.array([0.03, 0.02, 0.02, 0.03]) ** 2, np.array([0.002, 0.003])
SYSTEMATIC = np.array([0.02, 0.02, 0.01, 0.03, 0.05, 0.02]) ** 2
FAR = 100.0  # metres, farther than any path here


def path_of(poses: Floats, errors: Floats = PERFECT) -> Floats:
    """Return the path (n, 3) along measured poses (n, 3), corrected by systematic errors (6,)."""
    return np.asarray(corrected_path(poses, *errors[:3].tolist(), errors[3:].copy()))


def covariance_of(
    path: Floats,
    rates: Floats = EXACT[0],
    floors: Floats = EXACT[1],
    systematic: Floats = EXACT[2],
    turning: float = 1.0,
    correlation_length: float = FAR,
) -> Floats:
    return np.asarray(path_covariance(path, rates, floors, systematic, turning, correlation_length))


def assert_close(found: Floats, expected: Floats, tolerance: float) -> None:
    """Compare covariances relative to the standard deviations of what is expected."""
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    np.testing.assert_allclose(found / scale, expected / scale, atol=tolerance)


def straight(length: float, parts: int) -> Floats:
    return np.linspace(np.zeros(3), [length, 0.0, 0.0], parts + 1)


PATH = driven(twists_of(LEFT_AND_RIGHT))
ROWS = [*range(0, len(PATH) - 1, 5), len(PATH) - 1]  # 5 cm apart


def test_the_covariance_of_a_walking_heading_is_that_of_sampled_paths() -> None:
    random, path = np.random.default_rng(0), path_of(PATH)
    steps, turns = np.diff(path[:, :2], axis=0), np.abs(np.diff(path[:, 2]))
    travel = np.hypot(*steps.T) + 0.25 * turns
    variances = RATES[2] * travel + RATES[3] * turns
    walks = np.cumsum(random.standard_normal((SAMPLES, len(steps))) * np.sqrt(variances), axis=1)
    during = walks - 0.5 * np.diff(walks, axis=1, prepend=0.0)
    x = (np.cos(during) * steps[:, 0] - np.sin(during) * steps[:, 1]).sum(axis=1)
    y = (np.sin(during) * steps[:, 0] + np.cos(during) * steps[:, 1]).sum(axis=1)
    ends = np.column_stack([x, y, path[-1, 2] + walks[:, -1]])
    errors = se2.between(path[-1], ends) + random.standard_normal((SAMPLES, 3)) * FLOORS[[0, 0, 1]]
    rates = np.array([0.0, 0.0, *RATES[2:]])
    assert_close(covariance_of(path[ROWS], rates, FLOORS), np.cov(errors.T), 0.1)


@pytest.mark.parametrize("error", [*range(6), None])
def test_the_covariance_of_systematic_errors_is_that_of_sampled_errors(error: int | None) -> None:
    random, variances = np.random.default_rng(0), SYSTEMATIC.copy()
    if error is not None:
        variances[np.arange(6) != error] = 0.0
    drawn = PERFECT + random.standard_normal((SAMPLES, 6)) * np.sqrt(variances)
    path = path_of(PATH)
    found = covariance_of(path[ROWS], floors=np.array([1e-4, 1e-4]), systematic=variances)
    errors = se2.between(path[-1], np.array([path_of(PATH[ROWS], row)[-1] for row in drawn]))
    errors += 1e-4 * random.standard_normal((SAMPLES, 3))
    assert_close(found, np.cov(errors.T), 0.1)


@pytest.mark.parametrize("turn", [0.5, -0.3, 0.0])
def test_the_covariance_of_systematic_errors_is_that_of_one_motion_too(turn: float) -> None:
    random, motion = np.random.default_rng(0), np.stack([np.zeros(3), se2.exp([0.5, 0.0, turn])])
    drawn = PERFECT + random.standard_normal((SAMPLES, 6)) * np.sqrt(SYSTEMATIC)
    errors = se2.between(motion[-1], np.array([path_of(motion, row)[-1] for row in drawn]))
    assert_close(covariance_of(motion, systematic=SYSTEMATIC), np.cov(errors.T), 0.1)


def test_a_path_in_few_parts_has_the_covariance_of_one_in_many() -> None:
    turn = [3.0, 0.0, 0.25 * np.pi]
    paths = [np.vstack([straight(3.0, parts), turn]) for parts in (1, 60)]
    one, many = (covariance_of(path, RATES, FLOORS, SYSTEMATIC) for path in paths)
    np.testing.assert_allclose(one, many, atol=1e-12)
    few, many = (driven(np.array([[2.0, 0.0, 1.2]] * parts) / parts) for parts in (25, 200))
    assert_close(*(covariance_of(path, RATES, FLOORS, SYSTEMATIC) for path in (few, many)), 0.02)


def test_position_errs_in_proportion_to_the_travel_at_first_and_as_a_random_walk_beyond() -> None:
    length, rates = 20.0, np.array([*RATES[:2], 0.0, 0.0])
    variances = {
        travel: covariance_of(straight(travel, 100), rates, correlation_length=length) for travel in (5, 10, 20, 40, 80)
    }
    for travel, covariance in variances.items():
        np.testing.assert_allclose(covariance, np.diag([*RATES[:2], 0.0]) * travel * min(travel, length), atol=1e-12)


def test_errors_along_the_path_before_a_turn_are_across_after_it() -> None:
    path = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 0.0, QUARTER_TURN], [4.0, 2.0, QUARTER_TURN]])
    covariance = covariance_of(path, np.array([RATES[0], 0.0, 0.0, 0.0]), correlation_length=1.0)
    assert covariance[1, 1] == pytest.approx(4.0 * RATES[0])
    assert covariance[0, 1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("turning", [1.0, 1.09, 0.9])
@pytest.mark.parametrize("direction", [-1, 1])
def test_a_turn_of_more_than_a_quarter_between_two_poses_may_be_one_in_the_other_direction(
    turning: float, direction: int
) -> None:
    """Two poses of odometry tell a turn up to full turns only."""
    certain, uncertain = (
        covariance_of(np.array([np.zeros(3), [1.0, 0.0, direction * turn]]), turning=turning)
        for turn in (QUARTER_TURN - 1e-6, QUARTER_TURN + 1e-6)
    )
    other = se2.wrap(2.0 * np.pi * turning)  # corrected as one in the other direction, it is off by this
    assert (uncertain - certain)[2, 2] == pytest.approx(other**2, abs=1e-5)
    assert (uncertain - certain)[0, 0] == pytest.approx(other**2 / 3.0, abs=1e-5)  # across the motion
    paths = np.array([np.zeros(3), [0.5, 0.0, 0.6 * QUARTER_TURN], [1.0, 0.0, 1.2 * QUARTER_TURN]])
    assert not covariance_of(paths, turning=turning).any()

"""Pins of simulated surveys: the place of the map, the error rate of correct pins, and pins that are wrong."""

import numpy as np
import pytest

from drivers import se2
from slam.errors import MapError
from slam.offline.corrections.pin_adjustment import ERROR_RATE, adjust
from slam.offline.corrections.pinned_value import PinnedValue

SURVEY = np.array([210.0, -35.0, 2.3])
"""Pose of the map in the survey."""
MAP_SIGMA, HEADING_SIGMA, PIN_SIGMA = 0.02, 0.004, 0.005


def values(rng: np.random.Generator, poses: int, walls: int, *, headings: int = 0) -> list[PinnedValue]:
    """Return pins at random places of a map with errors: of poses, the first ones with headings, and of walls."""
    result = []
    for k in range(poses + walls):
        truth = np.array([*rng.uniform(-20.0, 20.0, 2), rng.uniform(-np.pi, np.pi)])
        error = np.array([*rng.normal(0.0, MAP_SIGMA, 2), rng.normal(0.0, HEADING_SIGMA)])
        is_wall = k >= poses
        point = se2.compose(truth, [rng.uniform(-2.0, 2.0), 0.0, 0.0]) if is_wall else truth
        surveyed = se2.compose(SURVEY, point)
        heading = (float(surveyed[2]), 1e-3) if k < headings else None
        noisy = surveyed[:2] + rng.normal(0.0, PIN_SIGMA, 2)
        estimate = se2.compose(truth, error)
        result.append(PinnedValue(noisy, PIN_SIGMA**2 * np.eye(2), heading, estimate, is_wall))
    return result


def map_covariance(pins: list[PinnedValue]) -> np.ndarray:
    variances: list[float] = []
    for pin in pins:
        along = pin.along(se2.inverse(SURVEY)) if pin.is_wall else 0.0
        variances += [MAP_SIGMA**2 + along**2 * HEADING_SIGMA**2] * (1 if pin.is_wall else 2)
        variances += [HEADING_SIGMA**2] * (pin.heading is not None)
    return np.diag(variances)


def names(pins: list[PinnedValue]) -> list[str]:
    return [f"pin {k}" for k in range(len(pins))]


@pytest.mark.slow
def test_correct_pins_are_used_and_place_the_map() -> None:
    rng, left_out, squared = np.random.default_rng(0), 0, []
    for _ in range(25):
        pins = values(rng, 5, 4, headings=1)
        found = adjust(pins, names(pins), map_covariance(pins), fixed=False)
        left_out += int((~found.used).sum())
        squared.append(found.chi2 / found.dof)
        error = se2.compose(found.motion, SURVEY)
        assert np.hypot(*error[:2]) < 0.1
        assert abs(error[2]) < 0.01
    assert left_out <= 1  # expected are 25 times ERROR_RATE
    assert ERROR_RATE < 0.01
    assert np.mean(squared) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("wrong", [1, 6])
@pytest.mark.parametrize("error", [0.3, pytest.param(30.0, marks=pytest.mark.slow)])
def test_a_wrong_pin_is_left_out_and_no_other(wrong: int, error: float) -> None:
    """Of a pose, and of a wall."""
    rng = np.random.default_rng(3)
    for _ in range(3):
        pins = values(rng, 5, 4, headings=1)
        right = pins[wrong]
        across = se2.compose(SURVEY, right.estimate)[2] + np.pi / 2
        shift = error * np.array([np.cos(across), np.sin(across)])
        pins[wrong] = PinnedValue(right.point + shift, right.covariance, right.heading, right.estimate, right.is_wall)
        covariance = map_covariance([*pins[:wrong], right, *pins[wrong + 1 :]])
        found = adjust(pins, names(pins), covariance, fixed=False)
        assert np.flatnonzero(~found.used).tolist() == [wrong]
        assert found.p_value[wrong] < ERROR_RATE


def test_pins_in_the_frame_of_the_map_leave_it_where_it_is() -> None:
    pin = PinnedValue(np.array([4.0, 2.0]), 1e-4 * np.eye(2), None, np.array([4.01, 2.0, 0.3]), False)
    found = adjust([pin], ["pin"], 1e-4 * np.eye(2), fixed=True)
    np.testing.assert_array_equal(found.motion, 0.0)
    assert found.chi2 == pytest.approx(0.01**2 / 2e-4)


def test_pins_that_determine_no_place_are_refused() -> None:
    rng = np.random.default_rng(5)
    for pins in (values(rng, 1, 0), values(rng, 0, 2)):
        with pytest.raises(MapError, match="do not determine the place"):
            adjust(pins, names(pins), map_covariance(pins), fixed=False)


def test_pins_without_redundancy_are_used_and_are_not_checked() -> None:
    pins = values(np.random.default_rng(6), 1, 0, headings=1)
    found = adjust(pins, names(pins), map_covariance(pins), fixed=False)
    assert found.used.all()
    assert np.isnan(found.p_value).all()
    assert found.dof == 0


def test_two_poses_that_contradict_each_other_are_both_named() -> None:
    pins = values(np.random.default_rng(7), 2, 0)
    one, other = pins
    away = (other.point - one.point) / np.hypot(*(other.point - one.point))
    pins[1] = PinnedValue(other.point + away, other.covariance, None, other.estimate, False)
    with pytest.raises(MapError, match="either pin 0 or pin 1 is wrong"):
        adjust(pins, names(pins), map_covariance(pins), fixed=False)

"""Learned probability of slips, as a cost."""

import math

import numpy as np
import pytest

from slam.localisation.slip_statistics import SlipStatistics


def test_nothing_is_known_before_any_driving() -> None:
    assert SlipStatistics().cost == pytest.approx(math.log(20.0))


@pytest.mark.parametrize("probability", [0.002, 0.05, 0.3])
def test_the_cost_is_that_of_the_robots_own_slips(probability: float) -> None:
    random, costs = np.random.default_rng(0), []
    for _ in range(30):
        slips = SlipStatistics()
        for slipped in random.random(2000) < probability:
            slips.add(slipped=bool(slipped))
        costs.append(slips.cost)
    assert np.mean(costs) == pytest.approx(-math.log(probability), abs=0.3)


def test_a_drive_without_slips_makes_them_improbable_but_possible() -> None:
    slips = SlipStatistics(scans=100_000)
    assert 11.0 < slips.cost < 12.0
    slips.add(slipped=True)
    assert slips.cost < 11.0


@pytest.mark.parametrize("staying", [0.1, 0.5, 0.95])
def test_a_slip_after_a_slip_has_its_own_probability(staying: float) -> None:
    random, slips, slipped = np.random.default_rng(0), SlipStatistics(), False
    for _ in range(20_000):
        slipped = bool(random.random() < (staying if slipped else 0.01))
        slips.add(slipped=slipped)
    for last, probability in ((False, 0.01), (True, staying)):
        slips.after_slip = last
        assert np.exp(-slips.cost) == pytest.approx(probability, rel=0.2)
        assert np.exp(-slips.cost) + np.exp(-slips.cost_of_none) == pytest.approx(1.0)


def test_nothing_is_known_after_the_first_slip() -> None:
    slips = SlipStatistics(scans=1000)
    slips.add(slipped=True)
    assert slips.cost == slips.cost_of_none == pytest.approx(math.log(2.0))

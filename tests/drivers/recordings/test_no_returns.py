"""Readings that stand for a no-return are found, and those of walls are not taken for them."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.messages import Floats
from drivers.recordings.no_returns import MAX_SAMPLE, SpreadSample, find_no_return

SCANS, BEAMS = 60, 180


def room_scans(seed: int, width: float = 9.0, depth: float = 6.0) -> list[Floats]:
    """Return scans (metres, with noise of 1 cm) from random places in an empty room."""
    random = np.random.default_rng(seed)
    scans = []
    for _ in range(SCANS):
        x, y = random.uniform(0.5, width - 0.5), random.uniform(0.5, depth - 0.5)
        angles = random.uniform(0, 2 * np.pi) + np.linspace(0, np.pi, BEAMS)
        c, s = np.cos(angles), np.sin(angles)
        ranges = np.minimum(np.where(c > 0, width - x, x) / np.abs(c), np.where(s > 0, depth - y, y) / np.abs(s))
        scans.append(ranges + random.normal(0.0, 0.01, BEAMS))
    return scans


def with_values(scans: list[Floats], low: float, high: float, *, share: float, in_scans: int, seed: int = 0) -> None:
    """Replace a share of the readings of the first scans by values between low and high, both included."""
    random = np.random.default_rng(seed)
    for scan in scans[:in_scans]:
        chosen = random.random(len(scan)) < share
        scan[chosen] = random.uniform(low, high, np.count_nonzero(chosen))
    scans[0][:2] = low, high


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("low", "high"), [(8.183, 8.191), (51.05, 51.16), (81.83, 81.91)])
@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_values_of_a_narrow_band_are_no_returns_in_any_unit(low: float, high: float, unit: float, seed: int) -> None:
    scans = room_scans(seed, 5.0, 4.0)
    with_values(scans, low, high, share=0.1, in_scans=SCANS, seed=seed)
    assert find_no_return([unit * scan for scan in scans]) == pytest.approx(unit * low)


def test_single_repeated_value_is_a_no_return() -> None:
    scans = room_scans(0)
    with_values(scans, 29.99, 29.99, share=0.1, in_scans=SCANS)
    assert find_no_return(scans) == 29.99


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_ordinary_room_has_no_no_returns(seed: int, unit: float) -> None:
    assert find_no_return([unit * scan for scan in room_scans(seed)]) is None


@pytest.mark.parametrize("in_scans", [1, 2])
def test_far_wall_seen_in_few_scans_is_no_no_return(in_scans: int) -> None:
    scans = room_scans(1)
    with_values(scans, 30.0, 30.02, share=0.2, in_scans=in_scans)
    assert find_no_return(scans) is None


def test_values_that_are_not_positive_and_finite_are_ignored() -> None:
    scans = room_scans(2, 5.0, 4.0)
    with_values(scans, 51.05, 51.16, share=0.1, in_scans=SCANS)
    for scan in scans:
        scan[-3:] = np.nan, np.inf, -100.0
    assert find_no_return(scans) == pytest.approx(51.05)


def test_without_readings_there_are_no_no_returns() -> None:
    assert find_no_return([]) is None
    assert find_no_return([np.zeros(0), np.full(5, np.nan), np.zeros(3)]) is None


def test_far_wall_in_front_of_a_standing_robot_is_no_no_return() -> None:
    scans = room_scans(3, 5.0, 4.0)
    bearings = np.linspace(-np.pi / 2, np.pi / 2, BEAMS)
    facing = np.abs(bearings) < np.radians(4.0)
    for k, scan in enumerate(scans):
        scan[facing] = 19.5 / np.cos(bearings[facing]) + np.random.default_rng(k).normal(0.0, 0.01, facing.sum())
    assert find_no_return(scans) is None


@pytest.mark.parametrize("length", [0, 1, MAX_SAMPLE, MAX_SAMPLE + 1, 10 * MAX_SAMPLE + 3])
def test_sample_is_spread_evenly_over_the_sequence(length: int) -> None:
    sample = SpreadSample[int]()
    for item in range(length):
        sample.add(item)
    assert len(sample.items) == length if length <= MAX_SAMPLE else MAX_SAMPLE // 2 <= len(sample.items) <= MAX_SAMPLE
    assert len(set(np.diff(sample.items).tolist())) <= 1

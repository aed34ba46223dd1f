"""Seconds from scan to scan, from stamps that may come in bursts or have pauses."""

from __future__ import annotations

import numpy as np
import pytest

from slam.odometry.measurement_clock import MIN_PERIOD, PERIOD_SAMPLES, MeasurementClock

PERIOD = 0.2


def intervals(stamps: list[float]) -> np.ndarray:
    clock = MeasurementClock()
    return np.array([clock.interval(stamp) for stamp in stamps])


def in_bursts(scans: int, size: int, spacing: float) -> list[float]:
    """Stamps of a computer that reads `size` scans at once, `spacing` seconds apart, when the last of them is ready."""
    ready = PERIOD * size * (1 + np.arange(scans // size))
    return np.concatenate([last + spacing * np.arange(size) for last in ready]).tolist()


def test_even_stamps_are_their_own_intervals():
    assert intervals([PERIOD * k for k in range(300)])[1:] == pytest.approx(PERIOD)


def test_a_pause_is_one_long_interval():
    found = intervals([PERIOD * k for k in range(50)] + [30.0 + PERIOD * k for k in range(50)])
    assert found[50] == pytest.approx(30.0 - 49 * PERIOD)
    assert np.delete(found[1:], 49) == pytest.approx(PERIOD)


@pytest.mark.parametrize("size", [2, 3, 10, 20])
@pytest.mark.parametrize("spacing", [0.0, 0.001, 0.004])
def test_scans_of_a_burst_are_a_period_apart(size: int, spacing: float):
    # nearly all stamps follow each other at once, so the usual interval is no period of a lidar
    found = intervals(in_bursts(400, size, spacing))[PERIOD_SAMPLES:]
    assert found == pytest.approx(PERIOD, rel=0.25)  # a burst may be partly outside of the latest intervals


@pytest.mark.parametrize("size", [2, 10])
def test_missing_scans_are_no_burst(size: int):
    """The robot has driven on for as long as the lidar failed, and a scan after it may be from any place."""
    before = in_bursts(200, size, 0.001)
    after = [before[-1] + 40.0 + stamp for stamp in in_bursts(100, size, 0.001)]
    found = intervals([*before, *after])
    assert found[len(before)] == pytest.approx(after[0] - before[-1])
    assert np.delete(found, len(before))[PERIOD_SAMPLES:] == pytest.approx(PERIOD, rel=0.25)


@pytest.mark.parametrize("stamps", [[PERIOD * k for k in range(300)], in_bursts(400, 10, 0.001)])
def test_the_period_is_that_of_the_lidar(stamps: list[float]):
    clock = MeasurementClock()
    for stamp in [*stamps, stamps[-1] + 30.0 * PERIOD]:  # the last one after a pause
        clock.interval(stamp)
    assert clock.period == pytest.approx(PERIOD, rel=0.3)


def test_the_fastest_lidar_is_not_taken_for_a_burst():
    found = intervals([0.01 * k for k in range(200)])
    assert found[1:] == pytest.approx(0.01)
    assert MIN_PERIOD < 0.01

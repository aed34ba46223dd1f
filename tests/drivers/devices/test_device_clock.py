"""Mapping a device's clock to the host's with simulated delays."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.devices.device_clock import BIN, WINDOW, DeviceClock
from drivers.messages import Floats

START = 1.7e9
"""Seconds; as large as stamps of the time of day."""
MICROSECONDS = 1 << 32


def arrivals(times: Floats, mean: float, pause: float, random: np.random.Generator) -> Floats:
    """Return the times (n,) at which messages sent at `times` are read.

    mean   of the exponential delays, seconds
    pause  mean of the exponential pauses between 50 ms in which the host is busy, seconds; zero if it is never busy
    """
    arrived = times + random.exponential(mean, len(times))
    busy = times[0]
    while pause and busy < times[-1]:
        busy += random.exponential(pause)
        held = (arrived >= busy) & (arrived < busy + 0.05)
        arrived[held] = busy = busy + 0.05
    return np.asarray(np.maximum.accumulate(arrived))


def stamps(clock: DeviceClock, device: Floats, arrived: Floats) -> Floats:
    return np.array([clock.stamp(float(d), float(a)) for d, a in zip(device, arrived, strict=True)])


@settings(max_examples=25, deadline=None)
@given(
    rate=st.sampled_from([50.0, 66.7, 100.0, 230.0]),
    drift=st.floats(-2e-4, 2e-4),
    mean=st.floats(1e-4, 5e-3),
    pause=st.sampled_from([0.0, 0.05, 0.2]),
    begins=st.integers(0, MICROSECONDS - 1),
    seed=st.integers(0, 1000),
)
def test_stamps_are_accurate_to_2_ms(
    rate: float, drift: float, mean: float, pause: float, begins: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    times = START + np.arange(0.0, 30.0, 1 / rate)
    arrived = arrivals(times, mean, pause, random)
    device = (begins + (times - START) / (1 + drift) * 1e6) % MICROSECONDS
    clock = DeviceClock(1e-6, MICROSECONDS)
    found = stamps(clock, np.floor(device), arrived)
    settled = times > START + 5.0
    assert np.percentile(np.abs(found - times)[settled], 99) <= 2e-3
    assert np.all(found <= arrived)
    assert clock.jumps == 0
    assert abs(clock.drift - drift) < 1e-4


@pytest.mark.parametrize(
    ("tick", "wraps_at", "rate"), [(1e-3, 65536, 50.0), (1e-3, 30000, 375.0), (0.015, None, 1 / 0.015)]
)
def test_coarse_and_quickly_wrapping_clocks_are_fitted(tick: float, wraps_at: int | None, rate: float) -> None:
    random = np.random.default_rng(3)
    device = np.floor(np.arange(0.0, 150.0, 1 / rate) / tick + 1e-6)
    times = START + device * tick / (1 + 5e-5)
    clock = DeviceClock(tick, wraps_at)
    found = stamps(clock, device % wraps_at if wraps_at else device, arrivals(times, 1e-3, 0.1, random))
    assert np.percentile(np.abs(found - times)[times > START + 5], 99) <= 2e-3
    assert clock.jumps == 0


def test_a_drift_of_half_a_percent_is_estimated() -> None:
    times = START + np.arange(0.0, 40.0, 0.02)
    clock = DeviceClock(1e-6, MICROSECONDS)
    found = stamps(clock, np.floor((times - START) / 1.005 * 1e6), arrivals(times, 1e-3, 0.1, np.random.default_rng(1)))
    assert np.percentile(np.abs(found - times)[times > START + 5], 99) <= 2e-3
    assert clock.drift == pytest.approx(5e-3, rel=0.01)


@pytest.mark.parametrize("silence", [0.0, 1.0, 400.0])
@pytest.mark.parametrize("at", [1.0, 20.0, 100.0])
def test_a_restart_of_the_device_is_recognised(at: float, silence: float) -> None:
    random = np.random.default_rng(int(at))
    uptime = np.arange(0.0, at, 0.02)
    times = START + np.concatenate([uptime, at + silence + uptime[:1000]])
    device = np.concatenate([uptime + 500.0, uptime[:1000]]) * 1e6
    clock = DeviceClock(1e-6, MICROSECONDS)
    found = stamps(clock, device, arrivals(times, 1e-3, 0.0, random))
    assert clock.jumps == 1
    after = np.abs(found - times)[len(uptime) :]
    assert np.max(after[:50]) < 0.02
    assert np.all(after[50:] < 2e-3)


def test_a_small_step_back_by_lost_samples_is_corrected() -> None:
    random = np.random.default_rng(2)
    numbers = np.arange(3000)
    received = (numbers < 1500) | (numbers >= 1504)
    times = START + 0.015 * numbers[received]
    clock = DeviceClock(0.015)
    found = stamps(clock, np.arange(len(times), dtype=float), arrivals(times, 1e-3, 0.0, random))
    error = np.abs(found - times)
    assert clock.jumps == 1
    assert np.max(error[:1500]) < 0.02
    assert np.percentile(error[times > START + 0.015 * 1500 + 2.5], 99) <= 2e-3
    assert np.max(error) <= 0.06 + 0.002


def test_a_backlog_at_the_start_is_discarded() -> None:
    times = START + np.arange(0.0, 20.0, 0.02)
    arrived = np.maximum(times + 1e-3, START + 0.7)  # the port was opened late
    clock = DeviceClock(1e-6, MICROSECONDS)
    found = stamps(clock, (times - START) * 1e6, arrived)
    assert np.max(np.abs(found - times)[times > START + 0.7]) < 2e-3
    assert clock.jumps == 0


def test_a_stall_of_the_host_does_not_change_the_stamps() -> None:
    times = START + np.arange(0.0, 30.0, 0.02)
    arrived = times + 1e-3
    held = (times > START + 15) & (times < START + 16.5)
    arrived[held] = START + 16.5
    clock = DeviceClock(1e-6, MICROSECONDS)
    found = stamps(clock, (times - START) * 1e6, arrived)
    assert np.max(np.abs(found - times)[times > START + 1]) < 1.5e-3
    assert clock.jumps == 0


@settings(max_examples=30, deadline=None)
@given(at=st.integers(300, 600), wrong=st.integers(0, MICROSECONDS - 1))
def test_a_single_wrong_time_does_not_change_other_stamps(at: int, wrong: int) -> None:
    times = START + np.arange(0.0, 15.0, 0.02)
    device = (times - START) * 1e6
    device[at] = wrong
    clock = DeviceClock(1e-6, MICROSECONDS)
    found = stamps(clock, device, times + 1e-3)
    error = np.abs(found - times)
    error[at] = 0.0
    assert np.max(error) < 0.012
    assert clock.jumps == 0


@settings(deadline=None)
@given(
    pairs=st.lists(
        st.tuples(st.floats(-1e12, 1e12, allow_nan=False), st.floats(0, 1e10, allow_nan=False)), max_size=200
    ),
    wraps_at=st.sampled_from([None, 30000, 65536, MICROSECONDS]),
)
def test_stamps_are_finite_and_not_later_than_the_arrival(
    pairs: list[tuple[float, float]], wraps_at: int | None
) -> None:
    clock = DeviceClock(1e-3, wraps_at)
    for device, arrived in pairs:
        stamp = clock.stamp(device, arrived)
        assert math.isfinite(stamp)
        assert stamp <= arrived


def test_memory_is_bounded() -> None:
    clock = DeviceClock(1e-3)
    for i in range(60_000):
        clock.stamp(float(10 * i), 0.01 * i + 1e-3)
    assert clock.stored_pairs <= WINDOW / BIN

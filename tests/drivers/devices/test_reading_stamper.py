"""Stamps of wheel bases are right from the first reading of a connection."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import Odometry
from drivers.bases import Create2Device, KobukiDevice, WheelDevice, WheelReading, create2, kobuki
from drivers.devices.wheel_base import WheelBaseDevice
from drivers.transport import Received

START = 1000.0
DELAY = 0.2
BASES: dict[str, tuple[type[WheelDevice], float, float]] = {
    "create2": (Create2Device, 0.015, create2.WHEELS.left),
    "kobuki": (KobukiDevice, 0.02, kobuki.WHEELS.left),
}
"""Device's side, seconds between readings, and metres per count, by kind."""


def odometry(kind: str, arrivals: np.ndarray, device_times: np.ndarray) -> list[Odometry]:
    """Return the odometry of a base that drives straight by a count per reading.

    arrivals      (n,) seconds at which the host would read them if their transmission took no time
    device_times  (n,) times that the base states, milliseconds; not used by create2
    """
    device, base = BASES[kind][0](), WheelBaseDevice(kind, {})
    frames = [device.encode(WheelReading(i, i, round(time))) for i, time in enumerate(device_times)]
    transmission = len(frames[0]) * 10 / base.bauds[0]
    messages = []
    for now in np.unique(arrivals):
        data = b"".join(frames[i] for i in np.flatnonzero(arrivals == now))
        messages += base.feed(Received(data, float(now) + transmission))
    assert all(isinstance(message, Odometry) for message in messages)
    return [message for message in messages if isinstance(message, Odometry)]


def errors(kind: str, times: np.ndarray, messages: list[Odometry]) -> np.ndarray:
    """Return the seconds (n,) by which stamps are late. The pose tells which reading a message is."""
    numbers = np.round([message.pose[0] / BASES[kind][2] for message in messages]).astype(int)
    return np.array([message.stamp for message in messages]) - times[numbers]


def busy_at_first(times: np.ndarray) -> np.ndarray:
    """Return arrivals (n,): all readings of the first 0.2 s are late by 0.2 s, the next ones by less and less."""
    return np.asarray(np.maximum(times, np.minimum(times + DELAY, times[0] + 2 * DELAY)))


@pytest.mark.parametrize("kind", sorted(BASES))
def test_a_host_that_is_busy_at_first_does_not_delay_stamps(kind: str) -> None:
    period = BASES[kind][1]
    times = START + period * np.arange(round(2.0 / period))
    messages = odometry(kind, busy_at_first(times), 65000 + 1000 * (times - START))  # wraps in the first second
    assert len(messages) == len(times)
    assert np.abs(errors(kind, times, messages)).max() < 2e-3


def test_stamps_are_those_by_arrival_if_the_clock_restarts_at_first() -> None:
    times = START + 0.02 * np.arange(100)
    device_times = 40000 + 1000 * (times - START)
    device_times[10:] -= device_times[10]
    messages = odometry("kobuki", times, device_times)
    late = errors("kobuki", times, messages)
    assert len(messages) == len(times)
    assert np.all(np.diff([message.stamp for message in messages]) > 0.0)
    assert np.abs(late).max() < 2e-3


def test_readings_lost_at_first_do_not_change_the_stamps_before() -> None:
    times = START + 0.015 * np.arange(200)
    kept = np.r_[0:15, 25:200]  # 150 ms are missing in the first half second
    messages = odometry("create2", times[kept], np.zeros(len(kept)))
    late = errors("create2", times[kept], messages)
    assert len(messages) == len(kept)
    assert np.abs(late[:15]).max() < 2e-3
    assert np.abs(late[17:]).max() < 2e-3  # a single late reading may have been delayed

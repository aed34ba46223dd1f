"""Messages delivered as they arrive: none is lost or repeated, and odometry after a pause is in order again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import Message, Odometry, Scan
from drivers.devices.acquisition import Acquisition
from drivers.devices.device_spec import parse_devices
from drivers.devices.early_delivery import MAX_PAUSE, EarlyDelivery
from drivers.devices.reorder_buffer import ReorderBuffer
from drivers.recordings.mcap import McapReader

BASE, LIDAR = 0, 1
Stamps = list[tuple[type, float]]


def odometry(stamp: float) -> Odometry:
    return Odometry(stamp, np.zeros(3))


def scan(stamp: float) -> Scan:
    return Scan(stamp, np.ones(2), np.arange(2.0), np.array([0.0, 0.1]), 0.1, 9.0)


def stamps(messages: list[Message]) -> Stamps:
    return [(type(message), round(message.stamp, 3)) for message in messages]


class Delivery:
    """A reorder buffer with early delivery; what was delivered, and what was recorded in order."""

    def __init__(self) -> None:
        self.delivered: list[Message] = []
        self.recorded: list[Message] = []
        self._early = EarlyDelivery(self.delivered.append)
        self._buffer = ReorderBuffer(2, 0.0, early=self._early)

    def put(self, device: int, *messages: Message) -> None:
        self._buffer.put(device, list(messages))
        self._take(self._buffer.pop(-np.inf, 0.0))

    def end(self) -> None:
        self._take(self._buffer.flush())

    def _take(self, messages: list[Message]) -> None:
        for message in messages:
            self.recorded.append(message)
            self._early.ordered(message)


def started() -> Delivery:
    delivery = Delivery()
    delivery.put(BASE, odometry(0.0))
    delivery.put(LIDAR, scan(0.01))
    delivery.put(BASE, odometry(0.13))
    assert stamps(delivery.delivered) == [(Odometry, 0.0), (Scan, 0.01), (Odometry, 0.13)]
    return delivery


def test_odometry_and_scans_are_delivered_when_they_arrive_and_recorded_in_order() -> None:
    delivery = started()
    for k in range(7, 12):
        delivery.put(BASE, odometry(0.02 * k))
        assert delivery.delivered[-1].stamp == 0.02 * k
    delivery.put(LIDAR, scan(0.11))
    assert stamps(delivery.delivered)[-2:] == [(Odometry, 0.22), (Scan, 0.11)]
    assert stamps(delivery.recorded) == sorted(stamps(delivery.recorded), key=lambda item: item[1])


def test_the_first_odometry_after_a_pause_follows_the_scan_that_began_before_it() -> None:
    delivery = started()
    resumed = 0.15 + MAX_PAUSE
    delivery.put(LIDAR, scan(0.12), scan(0.23))
    delivery.put(BASE, odometry(resumed), odometry(resumed + 0.02))
    assert delivery.delivered[-1].stamp == 0.23  # the scan that is being measured comes first
    delivery.put(LIDAR, scan(0.34))
    assert [message.stamp for message in delivery.delivered[-3:]] == [0.34, resumed, resumed + 0.02]
    delivery.put(BASE, odometry(resumed + 0.1))
    assert delivery.delivered[-1].stamp == resumed + 0.1  # as it arrives again


@given(st.lists(st.tuples(st.sampled_from([BASE, LIDAR]), st.floats(0.0, 0.6)), max_size=60))
def test_every_message_is_delivered_once_and_those_of_a_device_in_order(steps: list[tuple[int, float]]) -> None:
    delivery, ends = Delivery(), [0.0, 0.0]
    for device, pause in steps:
        begin = ends[device] + pause
        ends[device] = begin + (0.1 if device == LIDAR else 1e-3)
        delivery.put(device, scan(begin) if device == LIDAR else odometry(begin))
    delivery.end()
    assert sorted(map(id, delivery.delivered)) == sorted(map(id, delivery.recorded))
    for kind in (Odometry, Scan):
        own = [message.stamp for message in delivery.delivered if isinstance(message, kind)]
        assert own == sorted(own)


@given(st.lists(st.tuples(st.sampled_from([BASE, LIDAR]), st.floats(0.0, MAX_PAUSE - 0.01)), max_size=60))
def test_every_message_is_delivered_as_it_arrives_while_odometry_does(steps: list[tuple[int, float]]) -> None:
    delivery, ends = started(), [0.13, 0.11]
    for device, pause in steps:
        begin = ends[device] + pause
        ends[device] = begin + (0.1 if device == LIDAR else 1e-3)
        delivery.put(device, scan(begin) if device == LIDAR else odometry(begin))
        assert stamps(delivery.delivered[-1:]) == [(Scan if device == LIDAR else Odometry, round(begin, 3))]


def test_a_live_consumer_gets_what_is_recorded(peer: Any, tmp_path: Path) -> None:
    """The same messages, each device in order, but odometry before the scan in which it was measured.

    In the order of the stamps, no scan would follow such odometry. On a busy host some scans arrive before it, so the
    devices run until ten scans have followed it.
    """
    path, messages, early = tmp_path / "drive.mcap", [], 0
    with Acquisition(parse_devices(peer.spec), path, in_order=False) as acquisition:
        while early < 10:
            if (message := acquisition.receive(0.1)) is not None:
                early += isinstance(message, Scan) and bool(messages) and messages[-1].stamp > message.stamp
                messages.append(message)
            assert len(messages) < 1500
        acquisition.stop()
        messages += list(acquisition)
    recorded = list(McapReader(path))
    for kind in (Odometry, Scan):
        own = [message.stamp for message in messages if isinstance(message, kind)]
        assert own == [message.stamp for message in recorded if isinstance(message, kind)]


@pytest.mark.slow
def test_scans_are_left_out_of_recording_and_run_while_paused(peer: Any, tmp_path: Path) -> None:
    path, before, after = tmp_path / "drive.mcap", [], []
    with Acquisition(parse_devices(peer.spec), path, in_order=False) as acquisition:
        while sum(isinstance(message, Scan) for message in before) < 3:
            before += [message for message in [acquisition.receive(0.1)] if message is not None]
        acquisition.pause(True)
        while len(after) < 100:
            after += [message for message in [acquisition.receive(0.1)] if message is not None]
        paused = [message for message in after[-40:] if isinstance(message, Scan)]
        acquisition.pause(False)
        while not isinstance(acquisition.receive(0.1), Scan):
            pass
    assert paused == []
    recorded = [message.stamp for message in McapReader(path) if isinstance(message, Scan)]
    assert max(np.diff(recorded)) > 0.5

"""The queue between devices and consumer: in the order of time, bounded, every loss counted."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import Odometry, Scan
from drivers.devices.reorder_buffer import BATCH, HOLD, Outlet


def odometry(stamp: float) -> Odometry:
    return Odometry(stamp, np.zeros(3))


def scan(stamp: float, duration: float = 0.1) -> Scan:
    return Scan(stamp, np.ones(2), np.arange(2.0), np.array([duration, 0.0]), 0.1, 9.0)


def take_all(outlet: Outlet, read: float) -> list[float]:
    stamps: list[float] = []
    while batch := outlet.take(read, 0.0):
        assert len(batch) <= BATCH
        stamps += [message.stamp for message in batch]
    return stamps


def test_a_scan_comes_before_the_odometry_that_was_measured_during_it() -> None:
    outlet = Outlet(2, offset=100.0)
    outlet.put(0, [scan(0.0)])
    outlet.put(1, [odometry(0.05), odometry(0.15)])
    outlet.put(0, [scan(0.1)])
    outlet.put(1, [odometry(0.25)])
    assert take_all(outlet, 0.26) == [100.0, 100.05, 100.1, 100.15]
    assert [message.stamp for message in outlet.flush()] == [100.25]


def test_a_silent_device_holds_the_others_back_for_a_while_only() -> None:
    outlet = Outlet(2, 0.0)
    outlet.put(1, [odometry(1.0), odometry(2.0)])
    assert take_all(outlet, 1.0 + HOLD - 0.01) == []
    assert take_all(outlet, 1.0 + HOLD) == [1.0]
    outlet.put(0, [scan(0.5)])
    assert take_all(outlet, 4.0) == [2.0]
    assert outlet.late == 1


def test_a_device_that_was_not_read_is_waited_for() -> None:
    """However long that takes: its messages are there, and only the computer was held up."""
    outlet = Outlet(2, 0.0)
    outlet.put(0, [scan(0.0)])
    outlet.put(1, [odometry(stamp) for stamp in np.arange(0.0, 10.0, 0.5)])
    assert take_all(outlet, read=0.1) == [0.0, 0.0]
    outlet.put(0, [scan(0.1), scan(9.0)])
    assert take_all(outlet, read=10.0) == [0.1, *np.arange(0.5, 8.9, 0.5), 9.0, 9.0]
    assert outlet.late == 0


def test_a_consumer_that_takes_nothing_and_a_device_that_sends_nothing_fill_no_memory() -> None:
    outlet = Outlet(2, 0.0, capacity=10)
    for stamp in range(100):
        outlet.put(1, [odometry(float(stamp))])
    assert outlet.dropped == 90
    assert [message.stamp for message in outlet.flush()] == [float(stamp) for stamp in range(90, 100)]


def test_the_oldest_messages_are_dropped_and_counted() -> None:
    outlet = Outlet(1, 0.0, capacity=10)
    outlet.put(0, [odometry(float(stamp)) for stamp in range(100)])
    assert take_all(outlet, 1000.0) == [float(stamp) for stamp in range(90, 100)]
    assert outlet.dropped == 90


@settings(max_examples=50)
@given(st.lists(st.tuples(st.integers(0, 1), st.floats(0.0, 0.3)), max_size=60))
def test_whatever_comes_is_given_out_in_order_or_counted(steps: list[tuple[int, float]]) -> None:
    outlet = Outlet(2, 0.0, capacity=20)
    clocks = [0.0, 0.0]
    given_out: list[float] = []
    for device, step in steps:
        clocks[device] += step
        outlet.put(device, [scan(clocks[0]) if device == 0 else odometry(clocks[1])])
        if step > 0.15:
            given_out += take_all(outlet, max(clocks))
    given_out += [message.stamp for message in outlet.flush()]
    assert given_out == sorted(given_out)
    assert len(given_out) + outlet.dropped + outlet.late == len(steps)

"""The reorder buffer: messages in time order, bounded, every loss counted."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import Odometry, Scan
from drivers.devices.reorder_buffer import MAX_BATCH, MAX_HOLD, ReorderBuffer
from drivers.messages import end_stamp


def odometry(stamp: float) -> Odometry:
    return Odometry(stamp, np.zeros(3))


def scan(stamp: float, duration: float = 0.1) -> Scan:
    return Scan(stamp, np.ones(2), np.arange(2.0), np.array([duration, 0.0]), 0.1, 9.0)


def pop_all(buffer: ReorderBuffer, read_until: float) -> list[float]:
    stamps: list[float] = []
    while batch := buffer.pop(read_until, 0.0):
        assert len(batch) <= MAX_BATCH
        stamps += [message.stamp for message in batch]
    return stamps


def test_a_scan_precedes_the_odometry_measured_during_it() -> None:
    buffer = ReorderBuffer(2, offset=100.0)
    buffer.put(0, [scan(0.0)])
    buffer.put(1, [odometry(0.05), odometry(0.15)])
    buffer.put(0, [scan(0.1)])
    buffer.put(1, [odometry(0.25)])
    assert pop_all(buffer, 0.26) == [100.0, 100.05, 100.1, 100.15]
    assert [message.stamp for message in buffer.flush()] == [100.25]


def test_a_silent_device_delays_the_others_for_at_most_the_hold_time() -> None:
    buffer = ReorderBuffer(2, 0.0)
    buffer.put(1, [odometry(1.0), odometry(2.0)])
    assert pop_all(buffer, 1.0 + MAX_HOLD - 0.01) == []
    assert pop_all(buffer, 1.0 + MAX_HOLD) == [1.0]
    buffer.put(0, [scan(0.5)])
    assert pop_all(buffer, 4.0) == [2.0]
    assert buffer.late == 1


def test_messages_wait_for_a_device_that_was_not_read() -> None:
    """For any duration: its messages exist, only the computer was held up."""
    buffer = ReorderBuffer(2, 0.0)
    buffer.put(0, [scan(0.0)])
    buffer.put(1, [odometry(stamp) for stamp in np.arange(0.0, 10.0, 0.5)])
    assert pop_all(buffer, read_until=0.1) == [0.0, 0.0]
    buffer.put(0, [scan(0.1), scan(9.0)])
    assert pop_all(buffer, read_until=10.0) == [0.1, *np.arange(0.5, 8.9, 0.5), 9.0, 9.0]
    assert buffer.late == 0


def test_memory_is_bounded_without_consumer_and_with_a_silent_device() -> None:
    buffer = ReorderBuffer(2, 0.0, capacity=10)
    for stamp in range(100):
        buffer.put(1, [odometry(float(stamp))])
    assert buffer.dropped == 90
    assert [message.stamp for message in buffer.flush()] == [float(stamp) for stamp in range(90, 100)]


def test_the_oldest_messages_are_dropped_and_counted() -> None:
    buffer = ReorderBuffer(1, 0.0, capacity=10)
    buffer.put(0, [odometry(float(stamp)) for stamp in range(100)])
    assert pop_all(buffer, 1000.0) == [float(stamp) for stamp in range(90, 100)]
    assert buffer.dropped == 90


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1), st.floats(0.0, 0.3)), max_size=60))
def test_all_messages_are_returned_in_order_or_counted(steps: list[tuple[int, float]]) -> None:
    buffer = ReorderBuffer(2, 0.0, capacity=20)
    clocks = [0.0, 0.0]
    given_out: list[float] = []
    for device, step in steps:
        clocks[device] += step
        buffer.put(device, [scan(clocks[0]) if device == 0 else odometry(clocks[1])])
        if step > 0.15:
            given_out += pop_all(buffer, max(clocks))
    given_out += [message.stamp for message in buffer.flush()]
    assert given_out == sorted(given_out)
    assert len(given_out) + buffer.dropped + buffer.late == len(steps)


def test_a_message_ends_with_its_last_measurement() -> None:
    scan = Scan(5.0, np.ones(3), np.arange(3.0), np.array([0.2, 0.1, 0.0]), 0.1, 9.0)
    assert end_stamp(scan) == 5.2
    assert end_stamp(Odometry(5.0, np.zeros(3))) == 5.0

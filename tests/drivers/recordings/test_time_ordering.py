"""Ordering messages whose stamps run backwards, as in real recordings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.messages import Message, Odometry, YawRate
from drivers.recordings.time_ordering import order_by_time, sort_within


class Anomalies:
    """Recorder of skipped and of corrected messages."""

    def __init__(self) -> None:
        self.skipped: list[str] = []
        self.corrected: list[str] = []

    def skip(self, line: int | None, reason: str) -> None:
        self.skipped.append(reason)

    def correct(self, text: str) -> None:
        self.corrected.append(text)


def order(stamps: list[float]) -> tuple[list[float], Anomalies]:
    anomalies = Anomalies()
    numbered = [(i + 1, Odometry(stamp, np.array([float(i), 0.0, 0.0]))) for i, stamp in enumerate(stamps)]
    return [message.stamp for message in order_by_time(numbered, anomalies)], anomalies


STEADY = [100 + 0.1 * i for i in range(100)]


def test_increasing_stamps_are_unchanged() -> None:
    out, anomalies = order(STEADY)
    assert out == STEADY
    assert not anomalies.skipped
    assert not anomalies.corrected


def test_equal_stamps_keep_their_order() -> None:
    anomalies = Anomalies()
    messages = [Odometry(1.0, np.array([float(i), 0, 0])) for i in range(20)]
    assert list(order_by_time(enumerate(messages), anomalies)) == messages


def test_small_disorder_is_sorted_and_counted() -> None:
    stamps = list(STEADY)
    stamps[50], stamps[51] = stamps[51], stamps[50]
    out, anomalies = order(stamps)
    assert out == STEADY
    assert len(anomalies.corrected) == 1
    assert not anomalies.skipped


@pytest.mark.parametrize("wrong", [0.0, 1e9, 50.0, 1000.0])
@pytest.mark.parametrize("at", [5, 50, 99])
def test_wrong_stamp_is_skipped(wrong: float, at: int) -> None:
    stamps = list(STEADY)
    stamps[at] = wrong
    out, anomalies = order(stamps)
    assert out == STEADY[:at] + STEADY[at + 1 :]
    assert len(anomalies.skipped) == 1


@pytest.mark.parametrize("wrong", [0.0, 1e9])
@pytest.mark.parametrize("at", [0, 1, 2, 3, 4])
def test_wrong_stamp_among_the_first_loses_only_the_messages_before_it(wrong: float, at: int) -> None:
    stamps = list(STEADY)
    stamps[at] = wrong
    out, anomalies = order(stamps)
    assert out == STEADY[at + 1 :]
    assert len(anomalies.skipped) == at + 1


def test_pause_is_kept() -> None:
    stamps = STEADY + [stamp + 3600 for stamp in STEADY]
    out, anomalies = order(stamps)
    assert out == stamps
    assert not anomalies.skipped


def test_no_message_is_lost_if_the_clock_is_set_back() -> None:
    stamps = STEADY + [stamp - 3600 for stamp in STEADY]
    out, anomalies = order(stamps)
    assert len(out) == 200
    assert out == sorted(out)
    assert np.diff(out) == pytest.approx([0.1] * 99 + [0.0] + [0.1] * 99, abs=1e-6)
    assert len(anomalies.corrected) == 1
    assert "set back" in anomalies.corrected[0]


def two_sensors(stall: float) -> list[Message]:
    """Return 100 s of two sensors at 10 Hz; the link of the second one stalls after 30 s, for `stall` seconds."""
    arrivals: list[tuple[float, int, Message]] = []
    for k in range(1000):
        stamp = 100 + 0.1 * k
        arrivals.append((stamp, 2 * k, Odometry(stamp, np.zeros(3))))
        arrived = 130.0 + stall if 30.0 <= stamp - 100 < 30.0 + stall else stamp + 0.05
        arrivals.append((arrived, 2 * k + 1, YawRate(stamp + 0.05, 0.0)))
    return [message for _, _, message in sorted(arrivals, key=lambda one: one[:2])]


@pytest.mark.parametrize("stall", [0.5, 5.0, 28.0])
def test_messages_of_a_sensor_that_arrive_late_are_sorted(stall: float) -> None:
    anomalies = Anomalies()
    messages = two_sensors(stall)
    assert [m.stamp for m in messages] != sorted(m.stamp for m in messages)
    out = list(order_by_time(enumerate(messages), anomalies))
    assert out == sorted(messages, key=lambda message: message.stamp)
    assert not anomalies.skipped
    assert not any("set back" in reason for reason in anomalies.corrected)
    assert any("more than a second late" in reason for reason in anomalies.corrected) == (stall > 1.0)


def test_the_clock_of_two_sensors_is_set_back() -> None:
    first = two_sensors(0.0)
    stamps = [replace(message, stamp=message.stamp - 3600) for message in first]
    anomalies = Anomalies()
    out = [message.stamp for message in order_by_time(enumerate([*first, *stamps]), anomalies)]
    assert len(out) == 4000
    assert out == sorted(out)
    assert np.max(np.diff(out)) < 0.11
    assert [reason for reason in anomalies.corrected if "sorted" not in reason] == [
        "clock was set back; later stamps are shifted"
    ]


def test_a_sensor_that_falls_silent_delays_the_others_for_a_minute_at_most() -> None:
    messages = [YawRate(100.0, 0.0), *(Odometry(100.1 + 0.1 * k, np.zeros(3)) for k in range(2000))]
    read: list[float] = []

    def numbered() -> Iterator[tuple[int, Message]]:
        for number, message in enumerate(messages):
            read.append(message.stamp)
            yield number, message

    for out in order_by_time(numbered(), Anomalies()):
        assert read[-1] - out.stamp < 61.2


def test_few_messages_need_no_confirmation() -> None:
    assert order([1.0, 1.1])[0] == [1.0, 1.1]
    assert order([])[0] == []


@given(st.lists(st.tuples(st.floats(0, 1e9) | st.floats(0, 100), st.booleans()), max_size=60))
def test_output_never_decreases_and_every_message_is_counted(messages: list[tuple[float, bool]]) -> None:
    anomalies = Anomalies()
    of_sensors = [Odometry(stamp, np.zeros(3)) if first else YawRate(stamp, 0.0) for stamp, first in messages]
    out = [message.stamp for message in order_by_time(enumerate(of_sensors), anomalies)]
    assert out == sorted(out)
    assert len(out) + len(anomalies.skipped) == len(messages)


@given(st.lists(st.integers(0, 20), max_size=30))
def test_messages_that_are_moved_a_little_are_sorted_again(early: list[int]) -> None:
    stamps = [0.1 * i - 0.01 * seconds for i, seconds in enumerate(early)]
    messages = [Odometry(stamp, np.array([float(i), 0.0, 0.0])) for i, stamp in enumerate(stamps)]
    assert list(sort_within(messages, 0.2)) == sorted(messages, key=lambda message: message.stamp)


def test_messages_in_order_are_not_held() -> None:
    messages = iter(Odometry(stamp, np.zeros(3)) for stamp in STEADY)
    assert [message.stamp for message, _ in zip(sort_within(messages, 0.0), range(3), strict=False)] == STEADY[:3]
    assert next(messages).stamp == STEADY[4]

"""Ordering messages whose stamps run backwards, as in real recordings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import Odometry
from drivers.recordings.time_ordering import order_by_time


class Anomalies:
    """Recorder of the reasons of skipped messages and anomalies."""

    def __init__(self) -> None:
        self.skipped: list[str] = []
        self.noted: list[str] = []

    def skip(self, line: int | None, reason: str) -> None:
        self.skipped.append(reason)

    def note(self, line: int | None, reason: str) -> None:
        self.noted.append(reason)


def order(stamps: list[float]) -> tuple[list[float], Anomalies]:
    anomalies = Anomalies()
    numbered = [(i + 1, Odometry(stamp, np.array([float(i), 0.0, 0.0]))) for i, stamp in enumerate(stamps)]
    return [message.stamp for message in order_by_time(numbered, anomalies)], anomalies


STEADY = [100 + 0.1 * i for i in range(100)]


def test_increasing_stamps_are_unchanged() -> None:
    out, anomalies = order(STEADY)
    assert out == STEADY
    assert not anomalies.skipped
    assert not anomalies.noted


def test_equal_stamps_keep_their_order() -> None:
    anomalies = Anomalies()
    messages = [Odometry(1.0, np.array([float(i), 0, 0])) for i in range(20)]
    assert list(order_by_time(enumerate(messages), anomalies)) == messages


def test_small_disorder_is_sorted_and_counted() -> None:
    stamps = list(STEADY)
    stamps[50], stamps[51] = stamps[51], stamps[50]
    out, anomalies = order(stamps)
    assert out == STEADY
    assert len(anomalies.noted) == 1
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
    assert len(anomalies.noted) == 1
    assert "set back" in anomalies.noted[0]


def test_few_messages_need_no_confirmation() -> None:
    assert order([1.0, 1.1])[0] == [1.0, 1.1]
    assert order([])[0] == []


@given(st.lists(st.floats(0, 1e9), max_size=60))
def test_output_never_decreases_and_every_message_is_counted(stamps: list[float]) -> None:
    out, anomalies = order(stamps)
    assert out == sorted(out)
    assert len(out) + len(anomalies.skipped) == len(stamps)

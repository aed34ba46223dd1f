"""Stamps that run backwards, as those of real recordings do."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import Odometry
from drivers.recordings.time_ordering import in_order


class Notes:
    def __init__(self) -> None:
        self.skipped: list[str] = []
        self.noted: list[str] = []

    def skip(self, line: int | None, reason: str) -> None:
        self.skipped.append(reason)

    def note(self, line: int | None, reason: str) -> None:
        self.noted.append(reason)


def order(stamps: list[float]) -> tuple[list[float], Notes]:
    notes = Notes()
    numbered = [(i + 1, Odometry(stamp, np.array([float(i), 0.0, 0.0]))) for i, stamp in enumerate(stamps)]
    return [message.stamp for message in in_order(numbered, notes)], notes


STEADY = [100 + 0.1 * i for i in range(100)]


def test_steady_stamps_pass() -> None:
    out, notes = order(STEADY)
    assert out == STEADY
    assert not notes.skipped
    assert not notes.noted


def test_equal_stamps_keep_their_order() -> None:
    notes = Notes()
    messages = [Odometry(1.0, np.array([float(i), 0, 0])) for i in range(20)]
    assert list(in_order(enumerate(messages), notes)) == messages


def test_small_disorder_is_sorted_and_counted() -> None:
    stamps = list(STEADY)
    stamps[50], stamps[51] = stamps[51], stamps[50]
    out, notes = order(stamps)
    assert out == STEADY
    assert len(notes.noted) == 1
    assert not notes.skipped


@pytest.mark.parametrize("wrong", [0.0, 1e9, 50.0, 1000.0])
@pytest.mark.parametrize("at", [5, 50, 99])
def test_wrong_stamp_is_skipped(wrong: float, at: int) -> None:
    stamps = list(STEADY)
    stamps[at] = wrong
    out, notes = order(stamps)
    assert out == STEADY[:at] + STEADY[at + 1 :]
    assert len(notes.skipped) == 1


@pytest.mark.parametrize("wrong", [0.0, 1e9])
@pytest.mark.parametrize("at", [0, 1, 2, 3, 4])
def test_wrong_stamp_among_the_first_takes_only_those_before_it_along(wrong: float, at: int) -> None:
    stamps = list(STEADY)
    stamps[at] = wrong
    out, notes = order(stamps)
    assert out == STEADY[at + 1 :]
    assert len(notes.skipped) == at + 1


def test_pause_is_kept() -> None:
    stamps = STEADY + [stamp + 3600 for stamp in STEADY]
    out, notes = order(stamps)
    assert out == stamps
    assert not notes.skipped


def test_clock_that_is_set_back_loses_nothing() -> None:
    stamps = STEADY + [stamp - 3600 for stamp in STEADY]
    out, notes = order(stamps)
    assert len(out) == 200
    assert out == sorted(out)
    assert np.diff(out) == pytest.approx([0.1] * 99 + [0.0] + [0.1] * 99, abs=1e-6)
    assert len(notes.noted) == 1
    assert "set back" in notes.noted[0]


def test_few_messages_need_no_confirmation() -> None:
    assert order([1.0, 1.1])[0] == [1.0, 1.1]
    assert order([])[0] == []


@given(st.lists(st.floats(0, 1e9), max_size=60))
def test_output_never_decreases_and_everything_is_accounted_for(stamps: list[float]) -> None:
    out, notes = order(stamps)
    assert out == sorted(out)
    assert len(out) + len(notes.skipped) == len(stamps)

"""Messages of a run are counted, and their stamps shifted to follow those of a session."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import GroundTruth, Odometry
from slam.reporting.input_statistics import InputStatistics, shift_after


@pytest.mark.parametrize(("first", "after"), [(0.0, 60.0), (0.0, 1.7e9), (1.7e9, 60.0)])
def test_a_drive_on_another_clock_is_shifted_to_after_the_session(first: float, after: float) -> None:
    assert 60.0 < first + shift_after(first, after) - after < 63.0
    assert shift_after(after + 0.5, after) == 0.0


def test_all_stamps_are_shifted_by_the_same_time() -> None:
    statistics, pose = InputStatistics(keeps_odometry=True), np.array([1.0, 2.0, 0.1])
    messages = [Odometry(2.0, pose), GroundTruth(2.5, pose), Odometry(2.9, pose)]
    shifted = list(statistics.read(messages, after=100.0))
    np.testing.assert_allclose([one.stamp - statistics.shift for one in shifted], [2.0, 2.5, 2.9])
    assert shifted[0].stamp > 100.0
    assert (statistics.first, statistics.last) == (shifted[0].stamp, shifted[-1].stamp)
    assert statistics.odometry == len(statistics.odometry_poses.rows) == 2
    assert statistics.truth is not None
    assert statistics.truth.stamps.tolist() == [shifted[1].stamp]


def test_the_stamps_of_a_run_without_a_session_stay() -> None:
    statistics, message = InputStatistics(), Odometry(2.0, np.zeros(3))
    assert list(statistics.read([message])) == [message]
    assert statistics.shift == 0.0
    assert statistics.truth is None

"""Odometry history: interpolation and order of the readings."""

import numpy as np
import pytest

from drivers.messages import Odometry
from slam.odometry.history import OdometryHistory

from ...traced_memory import traced_memory
from .circle import circle_history, pose_on_circle


def test_poses_are_interpolated_between_readings_and_constant_outside() -> None:
    history = circle_history()
    for stamp in (0.0, 0.05, 0.3, 0.512, 1.9):
        np.testing.assert_allclose(history.at(stamp), pose_on_circle(stamp), atol=2e-3)
    np.testing.assert_array_equal(history.at(-1.0), history.poses[0])
    np.testing.assert_array_equal(history.at(99.0), history.poses[-1])
    assert history.at_each(np.array([0.1, 0.2])).shape == (2, 3)
    assert history.at_each(np.zeros(0)).shape == (0, 3)


def test_headings_are_interpolated_the_shorter_way_round() -> None:
    history = OdometryHistory()
    history.add(Odometry(0.0, np.array([0.0, 0.0, 3.1])))
    history.add(Odometry(1.0, np.array([0.0, 0.0, -3.1])))
    assert abs(history.at(0.5)[2]) == pytest.approx(np.pi)


def test_a_reading_not_later_than_the_last_replaces_its_pose() -> None:
    history = OdometryHistory()
    assert history.latest == -np.inf
    for stamp, x in ((0.0, 0.0), (1.0, 1.0), (1.0, 2.0), (0.5, 3.0)):
        history.add(Odometry(stamp, np.array([x, 0.0, 0.0])))
    np.testing.assert_array_equal(history.stamps, [0.0, 1.0])
    np.testing.assert_array_equal(history.poses[:, 0], [0.0, 3.0])


def test_poses_at_several_stamps_are_those_at_each() -> None:
    history = circle_history()
    stamps = np.concatenate([history.stamps[::7], history.stamps[1::5] + 0.003, [-1.0, 99.0, 0.512]])
    np.testing.assert_array_equal(history.at_each(stamps), [history.at(stamp) for stamp in stamps.tolist()])


def test_a_copy_does_not_change_with_the_history() -> None:
    history = circle_history()
    other, poses = history.copy(), history.poses
    history.add(Odometry(history.latest, np.zeros(3)))
    history.add(Odometry(history.latest + 1.0, np.ones(3)))
    assert len(other) == len(poses) == len(history) - 1
    np.testing.assert_array_equal(other.poses, poses)


def test_a_copy_takes_no_memory_for_the_readings() -> None:
    """Each save of a live run copies them, which are more the longer the robot drives."""
    history = OdometryHistory.from_arrays(np.arange(100_000.0), np.zeros((100_000, 3)))
    with traced_memory() as memory:
        copy = history.copy()
    assert memory.peak < 0.01 * copy.poses.nbytes


def test_memory_of_a_reading_is_four_numbers() -> None:
    history = OdometryHistory()
    with traced_memory() as memory:
        for k in range(10_000):
            history.add(Odometry(float(k), np.array([k, 0.0, 0.0])))
    assert memory.kept < 10_000 * 4 * 8 * 1.2


def test_poses_at_few_stamps_need_little_memory_whatever_the_length_of_the_history() -> None:
    history = OdometryHistory.from_arrays(np.arange(100_000.0), np.zeros((100_000, 3)))
    with traced_memory() as memory:
        history.at_each(np.array([70_000.2, 70_001.5, 70_003.0]))
    assert memory.peak < 20_000


def test_travel_does_not_depend_on_the_blocks_in_which_it_is_summed(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = circle_history().travelled
    monkeypatch.setattr("slam.odometry.history.BLOCK", 3)
    np.testing.assert_array_equal(circle_history().travelled, whole)
    assert not len(OdometryHistory().travelled)


def test_quarter_turns_are_counted_along_the_way_and_from_their_begin() -> None:
    stamps = np.linspace(0.0, 10.0, 101)
    turned = np.interp(stamps, [0.0, 2.0, 6.0, 8.0, 10.0], np.radians([0.0, 80.0, -200.0, -200.0, -110.0]))
    poses = np.column_stack([stamps, np.zeros(101), (turned + np.pi) % (2.0 * np.pi) - np.pi])
    history = OdometryHistory.from_arrays(stamps, poses)
    found = history.quarter_turns(0.0, 10.0)
    np.testing.assert_allclose(np.interp(found[:, 0], stamps, np.degrees(turned)), [-90.0, -180.0], atol=7.0)
    assert len(history.quarter_turns(2.0, 10.0)) == 3
    assert len(history.quarter_turns(6.0, 9.0)) == 0
    assert len(OdometryHistory().quarter_turns(0.0, 1.0)) == 0

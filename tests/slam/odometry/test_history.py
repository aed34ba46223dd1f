"""Odometry history: interpolation and order of the readings."""

import numpy as np
import pytest

from drivers.messages import Odometry
from slam.odometry.history import OdometryHistory

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

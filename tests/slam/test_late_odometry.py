"""A base that boots while the robot moves already: the first scans come before odometry."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.evaluation.metrics import score_reference
from slam.io.tum import Trajectory
from slam.odometry.history import MAX_EXTENSION, OdometryHistory
from slam.odometry.measurement_clock import USUAL_PERIOD

BOOTING = 1.5
"""Seconds of scans without odometry."""


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("office", seed=22, duration=32.0, lidar=LidarModel(beams=360, rate=10.0)))


@pytest.fixture(scope="module")
def truth(drive: list[Message]) -> Trajectory:
    true = [message for message in drive if isinstance(message, GroundTruth)]
    return Trajectory(np.array([one.stamp for one in true]), np.array([one.pose for one in true]))


def largest_error(messages: list[Message], truth: Trajectory) -> float:
    """Return the largest error of the path from the first scan on, metres."""
    slam = Slam()
    for message in messages:
        slam.add(message)
    finished = slam.finish()
    begin = next(message.stamp for message in messages if isinstance(message, Scan))
    now = finished.stamps >= begin
    assert finished.stamps[now][0] < begin + 0.2  # the first scans are placed, too
    return float(score_reference(Trajectory(finished.stamps[now], finished.poses[now]), truth).figures()["ate_max"])


@pytest.mark.slow
def test_a_base_that_boots_while_the_robot_moves_costs_little_accuracy(drive: list[Message], truth: Trajectory) -> None:
    """Nothing is known of the motion meanwhile but what follows it, which differs in some of these places."""
    errors = []
    for begin in (7.0, 10.0, 13.0, 16.0, 19.0, 22.0, 25.0):
        ready = [m for m in drive if begin <= m.stamp < begin + 6.0 and not isinstance(m, GroundTruth)]
        booting = [m for m in ready if not (isinstance(m, Odometry) and m.stamp < begin + BOOTING)]
        errors.append(largest_error(booting, truth))
    assert np.median(errors) < 0.012
    assert max(errors) < 0.03


def test_before_its_first_reading_the_robot_is_taken_to_have_moved_evenly_for_a_while() -> None:
    """It drives on a circle at 0.5 m/s and 0.8 rad/s."""
    history, radius = OdometryHistory(), 0.5 / 0.8
    for stamp in np.arange(10.0, 10.5, 0.02).tolist():
        turn = 0.8 * (stamp - 10.0)
        history.add(Odometry(stamp, np.array([radius * np.sin(turn), radius * (1.0 - np.cos(turn)), turn])))
    count, long_ago = len(history), 10.0 - MAX_EXTENSION - 1.0
    history.extend_back(long_ago)
    assert history.earliest == long_ago
    for stamp in (9.93, 9.0, 10.0 - MAX_EXTENSION):
        turn = 0.8 * (stamp - 10.0)
        expected = [radius * np.sin(turn), radius * (1.0 - np.cos(turn)), turn]
        assert history.at(stamp) == pytest.approx(expected, abs=1e-3)
    assert history.at(long_ago) == pytest.approx(history.at(10.0 - MAX_EXTENSION))
    assert len(history) == count + round(MAX_EXTENSION / USUAL_PERIOD) + 1
    assert (len(history.copy().measured_stamps), history.copy().measured_stamps[0]) == (count, 10.0)


def test_nothing_is_added_before_the_wanted_stamp() -> None:
    history = OdometryHistory()
    for stamp in (10.0, 10.2):
        history.add(Odometry(stamp, np.array([stamp, 0.0, 0.0])))
    history.extend_back(9.87)
    assert history.earliest == pytest.approx(9.87, abs=1e-12)
    assert history.at(9.87)[0] == pytest.approx(9.87)


def test_a_history_of_one_reading_is_not_extended() -> None:
    history = OdometryHistory()
    history.add(Odometry(10.0, np.zeros(3)))
    history.extend_back(9.0)
    assert history.earliest == 10.0

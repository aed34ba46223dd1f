"""A kidnapped robot, or one without returns for a while, is relocalised in its own map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.simulation import LidarModel, Simulation
from slam import Finished, Slam
from slam.geometry.degeneracy import weakest_direction
from slam.io.tum import Trajectory
from slam.recognition.self_similarity import SelfSimilarity

ROBOT = LidarModel(beams=180)


def kidnapped(messages: Iterator[Message], begin: float, end: float) -> Iterator[Message]:
    """Yield the messages of a robot that is lifted at `begin` and put down at `end` (seconds after the start).

    There are no messages in between, and odometry does not include the motion.
    """
    start: float | None = None
    shift: se2.Pose | None = None
    last = np.zeros(3)
    for message in messages:
        start = message.stamp if start is None else start
        if begin <= message.stamp - start < end:
            continue
        if isinstance(message, Odometry):
            if message.stamp - start < begin:
                last = message.pose
            else:
                shift = se2.compose(last, se2.inverse(message.pose)) if shift is None else shift
                message = Odometry(message.stamp, se2.compose(shift, message.pose))
        yield message


def blinded(messages: Iterator[Message], begin: float, end: float) -> Iterator[Message]:
    """Yield the messages with scans that are empty between `begin` and `end` (seconds after the start)."""
    start: float | None = None
    for message in messages:
        start = message.stamp if start is None else start
        if isinstance(message, Scan) and begin <= message.stamp - start < end:
            message = replace(message, ranges=np.full_like(message.ranges, np.nan))
        yield message


def surrounded(messages: Iterator[Message], begin: float, end: float) -> Iterator[Message]:
    """Yield the messages with scans that show people all around the robot between two times after the start, seconds.

    Each stands somewhere else in each second, half a metre to two metres away.
    """
    start: float | None = None
    for message in messages:
        start = message.stamp if start is None else start
        elapsed = message.stamp - start
        if isinstance(message, Scan) and begin <= elapsed < end:
            distances = np.random.default_rng(int(elapsed)).uniform(0.5, 2.0, 12)
            person = (12 * np.arange(len(message.ranges))) // len(message.ranges)
            message = replace(message, ranges=np.fmin(message.ranges, distances[person]))
        yield message


@dataclass
class Run:
    """Result of a run, position errors of its keyframes in metres, and its localisation states."""

    result: Finished
    errors: np.ndarray
    states: list[str]


def run(messages: Iterator[Message]) -> Run:
    slam, truth = Slam(), []
    for message in messages:
        slam.add(message)
        if isinstance(message, GroundTruth):
            truth.append([message.stamp, *message.pose])
    result = slam.finish()
    told = np.array(truth)
    true = Trajectory(told[:, 0], told[:, 1:]).at(result.keyframes.stamps).poses
    error = se2.between(result.keyframes.poses, se2.between(true[0], true))
    states = result.summary["states"]
    assert isinstance(states, list)
    return Run(result, np.hypot(error[:, 0], error[:, 1]), [row["state"] for row in states])


def office(duration: float, seed: int = 3, lidar: LidarModel = ROBOT) -> Iterator[Message]:
    return iter(Simulation("office", seed=seed, duration=duration, lidar=lidar))


@pytest.mark.slow
@pytest.mark.parametrize(("begin", "end"), [(90.0, 105.0), (60.0, 75.0), (120.0, 150.0)])
def test_a_kidnapped_robot_is_relocalised(begin: float, end: float) -> None:
    outcome = run(kidnapped(office(230.0), begin, end))
    assert outcome.errors.max() < 0.05
    assert outcome.states[-1:] != ["LOST"]


def carried_back(duration: float) -> Iterator[Message]:
    """Yield a drive through the office, and the same drive again after the robot was carried back to its start.

    Wheels and lidar have other errors the second time.
    """
    last, end = np.zeros(3), 0.0
    for message in office(duration):
        last = message.pose if isinstance(message, Odometry) else last
        end = message.stamp
        yield message
    later = list(office(duration, seed=4))
    delay = end - later[0].stamp + 5.0
    first = next(message.pose for message in later if isinstance(message, Odometry))
    for message in later:
        if isinstance(message, Odometry):
            message = replace(message, pose=se2.compose(last, se2.between(first, message.pose)))
        yield replace(message, stamp=message.stamp + delay)


def test_a_robot_carried_back_to_its_start_is_relocalised() -> None:
    outcome = run(carried_back(15.0))
    assert outcome.errors.max() < 0.05
    assert outcome.states in ([], ["LOST", "OK"])
    assert outcome.result.stamps[-1] > 30.0


def test_a_carried_robot_is_not_placed_if_places_of_the_map_look_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SelfSimilarity, "of", lambda *_: 1e3)
    outcome = run(carried_back(15.0))
    parts = outcome.result.summary["parts"]
    assert isinstance(parts, list)
    assert [part["joined"] for part in parts] == [True, False]


def test_a_robot_that_is_carried_after_a_few_scans_is_lost_only_until_it_has_mapped_more() -> None:
    outcome = run(kidnapped(office(37.0, lidar=replace(ROBOT, rate=5.0)), 2.0, 27.0))
    summary = outcome.result.summary
    health, parts = summary["health"], summary["parts"]
    assert isinstance(health, dict)
    assert isinstance(parts, list)
    assert [part["joined"] for part in parts] == [True, False]
    assert outcome.states == ["LOST", "OK"]
    assert 0 < health["lost"] < 25  # of 60 scans


@pytest.mark.slow
def test_a_robot_that_people_surround_stays_in_its_part_of_the_map() -> None:
    outcome = run(surrounded(office(28.0, lidar=replace(ROBOT, beams=360)), 15.0, 18.0))
    assert outcome.errors.max() < 0.05
    assert outcome.states == ["LOST", "OK"]
    health = outcome.result.summary["health"]
    assert isinstance(health, dict)
    assert health["lost"] < 60  # of 280 scans
    assert "parts" not in outcome.result.summary


@pytest.mark.slow
def test_ten_seconds_without_returns_are_bridged() -> None:
    outcome = run(blinded(office(32.0, lidar=replace(ROBOT, rate=5.0)), 15.0, 25.0))
    assert outcome.errors.max() < 0.05
    assert outcome.states == []
    health = outcome.result.summary["health"]
    assert isinstance(health, dict)
    assert health["no_features"] == pytest.approx(50, abs=1)


def test_the_weakest_direction_of_an_information_matrix_is_found() -> None:
    along = np.array([np.cos(0.5), np.sin(0.5)])
    across = np.array([-along[1], along[0]])
    information = np.zeros((3, 3))
    information[:2, :2] = 1e4 * np.outer(across, across) + 1.0 * np.outer(along, along)
    information[2, 2] = 1e5
    assert weakest_direction(np.array([1.0, 2.0, 0.3]), information, 0.3) == pytest.approx(0.8)
    assert weakest_direction(np.zeros(3), information + 1e3 * np.diag([1.0, 1.0, 0.0]), 0.3) is None

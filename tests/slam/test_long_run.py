"""A robot that runs for days: what is kept of it does not grow with time, apart from some numbers for each message."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.messages import Message, Odometry, Scan
from drivers.simulation import LidarModel, Simulation, World
from slam import Slam
from slam.config import Config, config_to_toml
from slam.estimation import keyframe_links, scan_update
from slam.estimation.journal import STANDING_SCANS, UNDECIDED_SCANS, Journal
from slam.events import Finished
from slam.io.output_dir import CONFIG
from slam.io.sessions import read_session, write_session

RATE = 4.0
STANDING = 60.0
"""Seconds for which the robot stands."""
OUTER = 7.0 * np.array([[-1, -1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1], [-1, 1, -1, -1]])
RING_PATH = 5.0 * np.array(
    [[-0.5, -1], [0.5, -1], [-0.5, -1], [0.5, -1], [-0.5, -1], [1, -1], [1, 1], [-1, 1], [-1, -1], [0.5, -1]]
)
RING = World("ring", "a ring", np.concatenate([OUTER, OUTER * 3 / 7]), np.zeros((0, 3)), RING_PATH, 1.0)
"""A corridor around a block. The robot visits its start three times, drives around the block, and comes back."""


@pytest.fixture(scope="module")
def messages() -> list[Message]:
    """Return the messages of a robot that drives, stands for a while, and drives on."""
    simulation = Simulation("room", seed=1, duration=16.0, lidar=LidarModel(beams=90, rate=RATE))
    driven = [message for message in simulation if isinstance(message, Odometry | Scan)]
    half = driven[0].stamp + 8.0
    before, after = ([m for m in driven if (m.stamp < half) == early] for early in (True, False))
    scan = next(m for m in reversed(before) if isinstance(m, Scan))
    odometry = next(m for m in reversed(before) if isinstance(m, Odometry))
    random, standing = np.random.default_rng(0), list[Message]()
    for stamp in np.arange(half, half + STANDING, 1.0 / RATE).tolist():
        standing += [replace(odometry, stamp=stamp + k / (5 * RATE)) for k in range(5)]
        standing.append(replace(scan, stamp=stamp, ranges=scan.ranges + random.normal(0.0, 0.005, len(scan.ranges))))
    return [*before, *standing, *(replace(m, stamp=m.stamp + STANDING) for m in after)]


def run(messages: list[Message], *, keep_all_features: bool = False) -> tuple[Slam, Finished]:
    slam = Slam(keep_all_features=keep_all_features)
    for message in messages:
        slam.add(message)
    return slam, slam.finish()


@pytest.fixture(scope="module")
def live(messages: list[Message]) -> tuple[Slam, Finished]:
    return run(messages)


def test_features_of_a_robot_that_stands_are_not_kept(live: tuple[Slam, Finished], messages: list[Message]) -> None:
    scans = live[0].snapshot().session.scans
    begin = messages[0].stamp + 9.0
    standing = [scan for scan in scans if begin < scan.stamp < begin + STANDING - 2.0]
    kept = sum(len(scan.features.points.xy) > 0 for scan in standing)
    assert len(standing) > 2 * STANDING_SCANS
    assert kept <= STANDING_SCANS + UNDECIDED_SCANS


def test_the_result_does_not_depend_on_whether_they_are_kept(
    live: tuple[Slam, Finished], messages: list[Message]
) -> None:
    """`wclm run` keeps them, `wclm live` does not."""
    slam, finished = run(messages, keep_all_features=True)
    assert all(len(scan.features.points.xy) for scan in slam.session.scans)
    np.testing.assert_array_equal(finished.poses, live[1].poses)


def test_the_session_can_be_read(live: tuple[Slam, Finished], tmp_path: Path) -> None:
    (tmp_path / CONFIG).write_text(config_to_toml(Config()))
    write_session(tmp_path, live[0].session)
    restored = read_session(tmp_path)
    assert len(restored.scans) == len(live[0].session.scans)
    restored.scan_history()


def test_a_robot_that_stood_stays_where_it_was(live: tuple[Slam, Finished], messages: list[Message]) -> None:
    finished, begin = live[1], messages[0].stamp + 9.0
    there = (finished.stamps > begin) & (finished.stamps < begin + STANDING - 2.0)
    assert np.ptp(finished.poses[there, :2], axis=0).max() < 0.02


def test_features_of_old_scans_are_not_kept_while_the_robot_is_only_localised(
    live: tuple[Slam, Finished], messages: list[Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam.estimation.journal.LOCALISED_SCANS", 10)
    (tmp_path / CONFIG).write_text(config_to_toml(Config()))
    write_session(tmp_path, live[0].session)
    session = read_session(tmp_path)
    mapped = sum(len(scan.features.points.xy) > 0 for scan in session.scans)
    slam = Slam(resumed=session, frozen=True, start=np.zeros(3))
    for message in messages[: len(messages) // 2]:
        slam.add(replace(message, stamp=message.stamp + 1000.0))
    scans = slam.snapshot().session.scans
    assert len(scans) > len(session.scans) + 100
    assert sum(len(scan.features.points.xy) > 0 for scan in scans) <= mapped + 10
    assert len(slam.finish().poses)


def forth_and_back(seconds: float, legs: int) -> Iterator[list[Odometry | Scan]]:
    """Return the measurements of each leg of a drive along one way of some `seconds`."""
    simulation = Simulation("room", seed=3, duration=seconds, lidar=LidarModel(beams=180, rate=RATE))
    once = [message for message in simulation if isinstance(message, Odometry | Scan)]
    for leg in range(legs):
        messages = list[Odometry | Scan]()
        for message in once if leg % 2 == 0 else reversed(once):
            after = message.stamp - once[0].stamp if leg % 2 == 0 else once[-1].stamp - message.stamp
            still = replace(message, time_offsets=np.zeros(180)) if isinstance(message, Scan) else message
            messages.append(replace(still, stamp=1.5 * seconds * leg + after))
        yield messages


@pytest.mark.slow
def test_features_in_familiar_places_are_not_kept_wherever_the_last_keyframe_is() -> None:
    """The robot drives one way forth and back until all of it is familiar."""
    slam, keyframes, kept = Slam(), list[int](), list[int]()
    for messages in forth_and_back(22.0, 10):
        for message in messages:
            slam.add(message)
        keyframes.append(slam.slam_state.mapper.keyframe_count)
        kept.append(int(slam.snapshot().session.scans.has_features.sum()))
    new = keyframes[-1] - keyframes[-3]
    assert new <= 1
    assert kept[-1] - kept[-3] <= 4 * new  # of a new keyframe, and of the scans that waited for decisions before it


@pytest.mark.slow
def test_a_robot_on_patrol_makes_hardly_any_more_keyframes() -> None:
    """Where no keyframes are made, driving on counts: keyframes of many laps ago are of an earlier visit."""
    lap = Simulation("room", seed=0).trajectory.duration
    slam, keyframes, laps = Slam(), list[int](), 7
    for message in Simulation("room", seed=0, duration=laps * lap, lidar=LidarModel(beams=180, rate=2.5)):
        if isinstance(message, Odometry | Scan):
            slam.add(message)
            if message.stamp > (len(keyframes) + 1) * lap:
                keyframes.append(slam.slam_state.mapper.keyframe_count)
    assert keyframes[-1] - keyframes[3] < 0.1 * keyframes[0]  # in three laps


def test_a_robot_that_shuttles_along_a_short_way_makes_no_more_keyframes() -> None:
    """Its visits of a place are separated by few keyframes where these are far apart."""
    slam, keyframes = Slam(), list[int]()
    for messages in forth_and_back(18.0, 10):  # six metres
        for message in messages:
            slam.add(message)
        keyframes.append(slam.slam_state.mapper.keyframe_count)
    assert keyframes[-1] == keyframes[6]


@pytest.mark.slow
def test_a_place_is_familiar_only_by_linked_keyframes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Relative to others, which are near in an estimate with drift, the pose would close a loop without a decision."""
    monkeypatch.setattr(keyframe_links, "_is_well_known", lambda covariance: False)
    monkeypatch.setattr(scan_update, "search_loop", lambda state: None)
    slam = Slam()
    for message in Simulation(RING, seed=0, lidar=LidarModel(beams=180, rate=RATE)):
        if isinstance(message, Odometry | Scan):
            linked = slam.slam_state.local_field.inserted if slam.slam_state else []
            slam.add(message)
            anchor = slam.slam_state.anchor
            if anchor is not None and anchor.keyframe < slam.slam_state.mapper.keyframe_count - 1:
                assert anchor.keyframe in linked


def test_features_of_a_keyframe_are_kept_although_it_seemed_to_be_in_a_familiar_place(
    live: tuple[Slam, Finished],
) -> None:
    """A new part of the map begins with the scans that fitted nowhere, when the robot is found to be lost."""
    scans = list(live[0].session.scans)[: UNDECIDED_SCANS + 5]
    journal = Journal(keep_all_features=False)
    for scan in scans:
        journal.add(scan)
        journal.note_familiar_place()
        journal.mark_dispensable([scans[2].stamp, scans[-2].stamp])
    assert journal.scans.has_features.tolist() == [False, False, True, False, False] + [True] * UNDECIDED_SCANS
    journal.mark_rest_dispensable([scans[2].stamp, scans[-2].stamp])
    assert np.flatnonzero(journal.scans.has_features).tolist() == [2, len(scans) - 2]

"""A robot with two lidars that see half a circle each, ahead and astern."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import slam
from drivers.messages import GroundTruth, Message, Scan
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation
from slam import Config, Slam
from slam.cli.run_input import RecordingInput
from slam.config import LidarConfig, OdometryConfig, SecondLidarConfig, config_to_toml
from slam.errors import ConfigurationError
from slam.evaluation.metrics import score_reference
from slam.events import Finished
from slam.io.exports import place_scans
from slam.io.output_dir import CONFIG
from slam.io.recordings import open_source
from slam.io.sessions import read_session, write_session
from slam.io.tum import Trajectory

AHEAD, ASTERN = (0.2, 0.05, 0.0), (-0.25, 0.0, 3.1)
"""Mounts of the lidars."""
TOPICS = Config(lidar=LidarConfig(topic="/scan"), second_lidar=SecondLidarConfig(topic="/scan_2"))
LATE = 0.2
"""Seconds by which the clock of the second lidar is ahead in a test: the period of its scans."""


def run(messages: Iterable[Message], config: Config = TOPICS) -> Finished:
    pipeline = Slam(config)
    for message in messages:
        pipeline.add(message)
    return pipeline.finish()


def is_first(message: Message) -> bool:
    return not (isinstance(message, Scan) and message.lidar)


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    lidar, wheels = replace(LIDAR_MODELS["half"], rate=5.0), WHEEL_MODELS["bad"]
    return list(Simulation("office", 1, 10.0, lidar, wheels, AHEAD, ASTERN))


@pytest.fixture(scope="module")
def result(drive: list[Message]) -> Finished:
    return run(drive)


def error(finished: Finished, drive: list[Message]) -> float:
    """Return the root mean square error of the trajectory, metres."""
    truth = [message for message in drive if isinstance(message, GroundTruth)]
    reference = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    return score_reference(Trajectory(finished.stamps, finished.poses), reference).figures()["ate_rmse"]


def test_the_map_is_better_than_with_one(drive: list[Message], result: Finished) -> None:
    single = run(filter(is_first, drive), Config())
    assert error(result, drive) < 0.9 * error(single, drive)
    assert len(result.walls.identity) > 1.3 * len(single.walls.identity)
    assert result.summary["second_lidar"] == {"scans": 49, "joined": 49}
    assert not result.summary["suspects"]
    assert "lost" not in result.summary


@pytest.mark.slow
def test_a_clock_of_its_own_is_compensated(drive: list[Message], result: Finished) -> None:
    def late(seconds: float) -> list[Message]:
        messages = (m if is_first(m) else replace(m, stamp=m.stamp + seconds) for m in drive)
        return sorted(messages, key=lambda message: message.stamp)

    config = TOPICS.model_copy(update={"second_lidar": SecondLidarConfig(topic="/scan_2", delay=LATE)})
    assert error(run(late(LATE), config), drive) == pytest.approx(error(result, drive), rel=0.1)
    assert error(run(late(3.0 * LATE)), drive) > 1.5 * error(result, drive)


def test_scans_at_another_rate_are_joined(drive: list[Message], result: Finished) -> None:
    slow = [m for m in drive if is_first(m) or round(m.stamp * 5.0) % 2]
    finished = run(slow)
    assert finished.summary["second_lidar"]["joined"] == pytest.approx(25, abs=1)
    assert error(finished, drive) < error(result, drive) + 0.001


def test_two_lidars_without_odometry(drive: list[Message]) -> None:
    config = TOPICS.model_copy(update={"odometry": OdometryConfig(source="none")})
    finished = run((message for message in drive if isinstance(message, Scan)), config)
    assert error(finished, drive) < 0.02


@pytest.fixture(scope="module")
def recording(drive: list[Message], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("two") / "drive.mcap"
    with McapWriter(path) as writer:
        for message in drive:
            writer.write(message)
    return path


@pytest.mark.slow
def test_a_recording_contains_both(drive: list[Message], result: Finished, recording: Path) -> None:
    source = open_source(recording, TOPICS)
    messages = list(source)
    assert len(messages) == len(drive)
    scans = [message for message in messages if isinstance(message, Scan)]
    assert {scan.lidar: tuple(scan.mount) for scan in scans} == {0: AHEAD, 1: ASTERN}
    assert not source.report.skipped
    run_input = RecordingInput(source, reopen=str(recording))
    np.testing.assert_array_equal(run(messages, run_input.resolve(TOPICS)).poses, result.poses)
    assert set(run_input.facts()) == {"gaps", "timing", "second_timing", "interpretations", "doubts"}


def test_the_topics_must_be_named(recording: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"^second_lidar.topic: lidar.topic must name"):
        open_source(recording, Config(second_lidar=SecondLidarConfig(topic="/scan_2")))
    assert all(map(is_first, open_source(recording, Config())))


@pytest.mark.slow
def test_one_call_maps_both(result: Finished, recording: Path) -> None:
    np.testing.assert_array_equal(slam.run(recording, TOPICS).finished.poses, result.poses)


def test_scans_of_both_are_placed_in_the_map(drive: list[Message], result: Finished) -> None:
    placed = list(place_scans(drive, Trajectory(result.stamps, result.poses), TOPICS))
    assert len(placed) == sum(isinstance(message, Scan) for message in drive)
    ahead, astern = placed[:2]
    assert np.hypot(*(ahead.origin - astern.origin)) == pytest.approx(0.45, abs=0.01)


@pytest.mark.slow
def test_a_run_in_two_sessions(drive: list[Message], result: Finished, tmp_path: Path) -> None:
    """The second session takes over scans of both lidars that waited for odometry at the end of the first."""
    half = next(k for k, m in enumerate(drive) if m.stamp > 5.0 and not is_first(m)) + 1
    first = Slam(TOPICS)
    for message in drive[:half]:
        first.add(message)
    first.finish()
    assert {scan.lidar for scan in first.session.queued_scans} == {0, 1}
    (tmp_path / CONFIG).write_text(config_to_toml(TOPICS))
    write_session(tmp_path, first.session)
    second = Slam(TOPICS, resumed=read_session(tmp_path, solve=False))
    for message in drive[half:]:
        second.add(message)
    continued = second.finish()
    np.testing.assert_array_equal(continued.stamps, result.stamps)
    # The graph is solved anew; the final match of single scans enlarges the rounding errors.
    np.testing.assert_array_equal(continued.keyframes.stamps, result.keyframes.stamps)
    assert continued.keyframes.poses == pytest.approx(result.keyframes.poses, abs=1e-4)
    assert continued.poses == pytest.approx(result.poses, abs=1e-3)

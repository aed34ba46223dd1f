"""A gyroscope beside wheels whose turns are wrong, or beside no wheels."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import drivers
from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, YawRate
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LidarModel, Simulation
from slam import Config, Slam
from slam.cli.app import app
from slam.config import OdometryConfig
from slam.evaluation.metrics import score_reference
from slam.events import Finished
from slam.io.tum import Trajectory
from slam.odometry.gyroscope import Gyroscope

BIAS = np.radians(0.7)
"""Radians per second."""
NOISE = np.radians(0.3)
"""Radians per second, of each reading."""


def with_gyroscope(messages: list[Message], *, spoil: float = 1.0) -> Iterator[Message]:
    """Yield the messages with yaw rates between them; the turns of odometry are `spoil` times what they were."""
    random = np.random.default_rng(5)
    truth = before = wheels = None
    for message in messages:
        if isinstance(message, GroundTruth):
            if truth is not None and message.stamp > truth.stamp:
                interval = message.stamp - truth.stamp
                rate = se2.wrap(message.pose[2] - truth.pose[2]) / interval
                yield YawRate(message.stamp - 0.5 * interval, float(rate) + BIAS + NOISE * random.standard_normal())
            truth = message
        if isinstance(message, Odometry):
            motion = np.zeros(3) if before is None else se2.between(before, message.pose)
            motion = motion * np.array([1.0, 1.0, spoil])
            before, wheels = message.pose, motion if wheels is None else se2.compose(wheels, motion)
            message = replace(message, pose=wheels)
        yield message


def run(messages: Iterator[Message], config: Config | None = None) -> Finished:
    slam = Slam(config)
    for message in messages:
        slam.add(message)
    return slam.finish()


def error(finished: Finished, messages: list[Message]) -> float:
    """Return the RMS distance from the true trajectory, metres."""
    truth = [message for message in messages if isinstance(message, GroundTruth)]
    reference = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    return score_reference(Trajectory(finished.stamps, finished.poses), reference).figures()["ate_rmse"]


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("office", seed=2, duration=14.0, lidar=LidarModel(beams=360, rate=5.0)))


@pytest.mark.parametrize("source", ["wheels", "none"])
def test_spoilt_turns_are_replaced_and_the_bias_is_known(drive: list[Message], source: str) -> None:
    config = Config(odometry=OdometryConfig.model_validate({"source": source}))
    finished = run(with_gyroscope(drive, spoil=1.3), config)
    assert error(finished, drive) < 0.01
    found = finished.summary["gyroscope"]
    assert abs(found["bias"] - BIAS) < 3.0 * found["sigma"]
    assert found["sigma"] < 0.1 * BIAS


def test_rates_are_recorded_and_read_again(drive: list[Message], tmp_path: Path) -> None:
    measured = [m for m in with_gyroscope(drive[:200]) if not isinstance(m, GroundTruth)]
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for message in measured:
            writer.write(message)
    rates = [message for message in measured if isinstance(message, YawRate)]
    read = [message for message in drivers.open(str(tmp_path / "drive.mcap")) if isinstance(message, YawRate)]
    np.testing.assert_array_equal([m.rate for m in read], [m.rate for m in rates])
    np.testing.assert_allclose([m.stamp for m in read], [m.stamp for m in rates], atol=1e-9)
    described = " ".join(CliRunner().invoke(app, ["info", str(tmp_path / "drive.mcap")]).output.split())
    assert re.search(rf"gyroscope {len(rates)}, \S+ per second, from /imu", described)


def test_a_silent_gyroscope_measures_no_turn() -> None:
    gyroscope = Gyroscope()
    assert gyroscope.turn(0.0, 0.1) is None
    for k in range(11):
        gyroscope.add(YawRate(0.01 * k, 2.0))
    assert gyroscope.turn(0.02, 0.07) == pytest.approx(0.1)
    assert gyroscope.turn(0.02, 0.15) == pytest.approx(0.26)  # the last rate is continued for a moment
    assert gyroscope.turn(0.02, 1.0) is None
    gyroscope.add(YawRate(2.0, 2.0))
    assert gyroscope.turn(0.05, 2.0) is None


def test_a_wrong_scan_does_not_change_the_bias() -> None:
    gyroscope = Gyroscope()
    for k in range(6001):
        gyroscope.add(YawRate(0.01 * k, 0.01))
        if k % 10 == 0:
            turn = 1.0 if k == 3000 else 0.0
            gyroscope.correct(0.01 * k, turn if k else None, 1e-6)
    assert abs(gyroscope.bias - 0.01) < 3.0 * gyroscope.sigma


def test_what_the_map_corrects_is_no_turn() -> None:
    """Registrations of a robot that does not turn are off by the same each time; each keyframe turns them back."""
    gyroscope = Gyroscope()
    for k in range(1001):
        gyroscope.add(YawRate(0.1 * k, 0.01))
        turned = 100 * -1e-4 if k % 100 == 0 else 0.0
        gyroscope.correct(0.1 * k, 1e-4, 1e-5, turned)
    assert abs(gyroscope.bias - 0.01) < gyroscope.sigma < 5e-4


def test_a_map_that_is_turned_does_not_change_the_bias() -> None:
    """As after a loop closure."""
    gyroscope = Gyroscope()
    for k in range(1001):
        gyroscope.add(YawRate(0.1 * k, 0.01))
        gyroscope.correct(0.1 * k, 0.0, 1e-6, 0.05 if k == 5 else 0.0)
    assert abs(gyroscope.bias - 0.01) < 3.0 * gyroscope.sigma

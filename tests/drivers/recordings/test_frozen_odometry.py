"""Odometry that stands still while the robot moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import Message, Odometry, Scan
from drivers.recordings.frozen_odometry import FrozenOdometryDetector
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LidarModel, Simulation
from slam.io.recordings import reason_without_odometry


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("office", seed=2, duration=30.0, lidar=LidarModel(beams=90)))


def detect(messages: list[Message]) -> FrozenOdometryDetector:
    detector = FrozenOdometryDetector()
    for message in messages:
        detector.add(message)
    detector.finish()
    return detector


def freeze(messages: list[Message], start: float, end: float) -> list[Message]:
    """Repeat the pose at `start` until `end`."""
    pose = next(m.pose for m in messages if isinstance(m, Odometry) and m.stamp >= start)
    return [replace(m, pose=pose) if isinstance(m, Odometry) and start <= m.stamp <= end else m for m in messages]


def test_a_drive_is_not_reported(drive: list[Message]) -> None:
    assert detect(drive).describe() is None


def test_frozen_odometry_is_reported_with_its_time(drive: list[Message]) -> None:
    detector = detect(freeze(drive, 10.0, 22.0))
    (frozen,) = detector.found
    assert frozen.start == pytest.approx(10.0, abs=0.05)
    assert frozen.duration == pytest.approx(12.0, abs=0.1)
    assert detector.describe() == "odometry stands still while the scans change (once, the longest 12.0 s at 0:10)"
    assert len(detect(freeze(drive, 10.0, 40.0)).found) == 1


def test_a_short_time_is_not_reported(drive: list[Message]) -> None:
    assert not detect(freeze(drive, 10.0, 13.0)).found


def test_missing_odometry_is_not_frozen(drive: list[Message]) -> None:
    assert not detect([m for m in drive if isinstance(m, Scan) or not 10.0 < m.stamp < 22.0]).found


def test_a_standing_robot_among_people_is_not_reported(drive: list[Message]) -> None:
    """Nearly a third of the beams, other ones in each scan, is covered by people."""
    random = np.random.default_rng(1)
    view = next(m for m in drive if isinstance(m, Scan))
    messages: list[Message] = []
    for i in range(300):
        covered = (np.arange(90) - random.integers(90)) % 90 < 28
        noisy = view.ranges + random.normal(0.0, 0.02, 90)
        messages.append(Odometry(0.1 * i, np.zeros(3)))
        messages.append(replace(view, stamp=0.1 * i, ranges=np.where(covered, 0.7, noisy)))
    assert not detect(messages).found


@pytest.mark.parametrize(("start", "ignored"), [(0.0, True), (10.0, False)])
def test_odometry_that_never_moves_is_ignored(
    drive: list[Message], tmp_path: Path, start: float, ignored: bool
) -> None:
    path = tmp_path / "drive.mcap"
    with McapWriter(path) as writer:
        for message in freeze(drive, start, 40.0):
            writer.write(message)
    reason = reason_without_odometry(drivers.open(str(path)))
    assert reason == ("odometry never moves in it, though the scans change" if ignored else None)


def test_odometry_of_a_standing_robot_is_used(drive: list[Message], tmp_path: Path) -> None:
    view = next(message for message in drive if isinstance(message, Scan))
    path = tmp_path / "drive.mcap"
    with McapWriter(path) as writer:
        for k in range(100):
            writer.write(Odometry(0.1 * k, np.zeros(3)))
            writer.write(replace(view, stamp=0.1 * k + 0.05))
    assert reason_without_odometry(drivers.open(str(path))) is None

"""Single readings of odometry that the next one takes back are left out; what a robot can drive is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers.messages import Message, Odometry
from drivers.recordings.mcap import McapWriter
from drivers.recordings.odometry_spikes import SPIKE
from drivers.simulation import Simulation


def read(path: Path, messages: list[Message]) -> tuple[list[Odometry], int]:
    """Return the odometry of a recording with messages, and how many readings were left out."""
    with McapWriter(path) as writer:
        for message in messages:
            writer.write(message)
    source = drivers.open(path)
    odometry = [message for message in source if isinstance(message, Odometry)]
    return odometry, source.report.corrected.get(SPIKE, 0)


def readings(poses: np.ndarray, period: float) -> list[Message]:
    return [Odometry(1.0 + period * i, pose) for i, pose in enumerate(poses)]


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("room", seed=1, duration=6.0))


@pytest.mark.parametrize("spike", [(0.6, 0.0, 0.0), (0.0, -1e7, 0.0), (0.0, 0.0, 2.5), (0.0, 0.0, -0.5)])
def test_single_damaged_readings_are_left_out(tmp_path: Path, drive: list[Message], spike: tuple[float, ...]) -> None:
    rows = [row for row, message in enumerate(drive) if isinstance(message, Odometry)]
    damaged = list(drive)
    for row in rows[20:-1:40]:
        message = drive[row]
        assert isinstance(message, Odometry)
        damaged[row] = replace(message, pose=message.pose + spike)
    odometry, left_out = read(tmp_path / "drive.mcap", damaged)
    assert left_out == len(rows[20:-1:40])
    kept = [drive[row] for row in rows if damaged[row] is drive[row]]
    assert [message.stamp for message in odometry] == pytest.approx([message.stamp for message in kept])


def test_two_damaged_coordinates_one_after_the_other_are_left_out(tmp_path: Path) -> None:
    poses = np.zeros((30, 3))
    poses[:, 0] = 0.05 * np.arange(30)
    damaged = poses.copy()
    damaged[20, 1], damaged[21, 2] = 2.0, 1.5
    odometry, left_out = read(tmp_path / "drive.mcap", readings(damaged, 0.2))
    assert left_out == 2
    np.testing.assert_allclose([message.pose for message in odometry], np.delete(poses, [20, 21], axis=0))


def test_odometry_that_is_wrong_throughout_is_kept(tmp_path: Path, drive: list[Message]) -> None:
    """With headings in degrees, it seems to turn anywhere at each reading: other checks find the unit."""
    wrong = [
        replace(message, pose=message.pose * [1.0, 1.0, np.degrees(1.0)]) if isinstance(message, Odometry) else message
        for message in drive
    ]
    odometry, left_out = read(tmp_path / "drive.mcap", wrong)
    assert left_out <= 0.02 * len(odometry)


@pytest.mark.parametrize("period", [0.02, 0.2, 1.0])
def test_a_robot_that_stops_turns_and_drives_back_keeps_its_odometry(tmp_path: Path, period: float) -> None:
    """At 2 m/s and 4 rad/s, also across the end of the range of angles; slips and jumps that last are kept, too."""
    times = np.arange(0.0, 12.0, period)
    poses = np.column_stack([1.3 * np.sin(1.5 * times), np.zeros_like(times), 3.0 + np.sin(4.0 * times)])
    poses[len(poses) // 2 :, 1] += 3.0
    poses[:, 2] = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    odometry, left_out = read(tmp_path / "drive.mcap", readings(poses, period))
    assert left_out == 0
    assert len(odometry) == len(poses)

"""Odometry that is too fast to be in metres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import Odometry, Scan
from drivers.recordings.mcap import McapWriter
from drivers.recordings.odometry_speed import OdometrySpeed
from drivers.simulation import LidarModel, Simulation
from slam.io.recordings import reason_without_odometry

DOUBT = "odometry is faster than 30 m/s wherever it moves, as if in millimetres or centimetres"


def record(path: Path, unit: float, seconds: float = 10.0) -> Path:
    """Write a drive whose odometry has `unit` per metre."""
    with McapWriter(path) as writer:
        for message in Simulation("office", seed=2, duration=seconds, lidar=LidarModel(beams=180)):
            if isinstance(message, Odometry):
                message = replace(message, pose=message.pose * np.array([unit, unit, 1.0]))
            if isinstance(message, Odometry | Scan):
                writer.write(message)
    return path


@pytest.mark.parametrize(("unit", "reason"), [(1.0, None), (1000.0, DOUBT), (100.0, DOUBT)])
def test_odometry_in_small_units_is_doubtful_and_not_used(tmp_path: Path, unit: float, reason: str | None) -> None:
    source = drivers.open(record(tmp_path / "drive.mcap", unit))
    assert reason_without_odometry(source) == reason
    assert sum(isinstance(message, Odometry) for message in source) > 100
    assert source.report.doubts == ([] if reason is None else [reason])


def test_a_fast_car_and_single_jumps_are_not_doubtful() -> None:
    stamps = np.arange(0.0, 20.0, 0.1)
    positions = np.column_stack([25.0 * stamps, np.zeros_like(stamps)])
    positions[50:] += 1000.0
    assert OdometrySpeed.of_path(stamps, positions).describe() is None
    speed = OdometrySpeed()
    for stamp, (x, y) in zip(stamps, 2.0 * positions, strict=True):
        speed.add(Odometry(stamp, np.array([x, y, 0.0])))
    assert speed.describe() == DOUBT

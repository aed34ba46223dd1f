"""Recordings that contain scans more than once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import Message, Odometry, Scan
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LidarModel, Simulation


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("room", seed=2, duration=5.0, lidar=LidarModel(beams=90)))


def read(path: Path, messages: list[Message]) -> tuple[list[Message], drivers.SourceReport]:
    with McapWriter(path) as writer:
        for message in messages:
            writer.write(message)
    source = drivers.open(str(path))
    return list(source), source.report


def test_copies_are_left_out_and_counted(drive: list[Message], tmp_path: Path) -> None:
    once, report = read(tmp_path / "once.mcap", drive)
    copies, counted = read(tmp_path / "copies.mcap", [m for m in drive for _ in range(3 if isinstance(m, Scan) else 1)])
    scans = sum(isinstance(m, Scan) for m in drive)
    assert [m.stamp for m in copies] == [m.stamp for m in once]
    assert not report.skipped
    assert counted.skipped == 2 * scans
    assert counted.reasons == {"copy of another scan; left out": 2 * scans}


def test_copies_with_odometry_between_them_are_left_out(drive: list[Message], tmp_path: Path) -> None:
    scan = next(m for m in drive if isinstance(m, Scan))
    reading = Odometry(scan.stamp, np.zeros(3))
    messages, _ = read(tmp_path / "between.mcap", [scan, reading, scan])
    assert [type(m) for m in messages] == [Scan, Odometry]


def test_other_scans_with_the_same_stamp_are_kept(drive: list[Message], tmp_path: Path) -> None:
    """Drivers that stamp to the second exist; their scans differ."""
    scan = next(m for m in drive if isinstance(m, Scan))
    messages, report = read(tmp_path / "same.mcap", [scan, replace(scan, ranges=scan.ranges + 0.01), scan])
    assert sum(isinstance(m, Scan) for m in messages) == 2
    assert report.skipped == 1


def test_scans_of_two_lidars_on_the_robot_are_no_copies(drive: list[Message], tmp_path: Path) -> None:
    scan = next(m for m in drive if isinstance(m, Scan))
    rear = replace(scan, mount=np.array([-0.2, 0.0, np.pi]))
    messages, report = read(tmp_path / "two.mcap", [scan, rear])
    assert len(messages) == 2
    assert not report.skipped

"""Point clouds are cut at a height."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import RecordingError, Scan, se2
from drivers.messages import Floats
from drivers.recordings.point_clouds import POINT_CLOUD, HeightCut, scan_of_cloud
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import LASER_SCAN, TRANSFORMS, LidarMount, decode
from drivers.source_factory import LidarSelection

from ...clouds import FLOAT32, FLOAT64, UINT32, cloud, cloud_of_scan

Stored = tuple[str, str, int, bytes]
WriteBag = Callable[[Path, list[Stored]], Path]
ENCODER = RosEncoder()


def cut_of(
    points: Floats,
    cut: HeightCut | None = None,
    pose: Floats | None = None,
    mount: LidarMount | None = None,
    times: tuple[str, int, Floats] | None = None,
    stamp: float = 1.0,
) -> Scan:
    message = decode(cloud(points, stamp, times=times, padding=5), POINT_CLOUD, "cdr")
    return scan_of_cloud(message, 0, pose, mount or LidarMount(), cut or HeightCut())


def room(height: float, size: float = 4.0) -> Floats:
    """Return points (n, 3) at a height on the walls of a square room."""
    bearings = np.radians(np.arange(-180.0, 180.0, 0.4))
    ranges = 0.5 * size / np.maximum(np.abs(np.cos(bearings)), np.abs(np.sin(bearings)))
    return np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings), np.full(len(bearings), height)])


def on_walls(scan: Scan) -> bool:
    points = np.column_stack([scan.ranges * np.cos(scan.angles), scan.ranges * np.sin(scan.angles)])
    if scan.mount is not None:
        points = se2.transform(scan.mount, points)
    return bool(np.allclose(np.abs(points).max(axis=1), 2.0, atol=1e-5))


def test_the_layer_at_the_height_becomes_a_scan() -> None:
    table = room(0.6, 2.0)
    scan = cut_of(np.concatenate([table, room(0.2), room(0.0, 3.0), room(1.8)]), HeightCut(0.25, 0.2))
    assert len(scan.ranges) == 900
    assert on_walls(scan)
    assert np.all(np.diff(scan.angles) > 0.0)
    lower = cut_of(np.concatenate([table, room(0.2)]), HeightCut(0.6))
    assert lower.ranges == pytest.approx(0.5 * scan.ranges)


def test_the_point_nearest_to_the_height_counts() -> None:
    """The nearest point would be the top of a low box."""
    layers = np.concatenate([room(0.42, 2.0), room(0.51), room(0.57, 5.0)])
    assert on_walls(cut_of(layers, HeightCut(0.5)))


def test_a_tilted_lidar_is_levelled() -> None:
    """The lidar looks down by 25 degrees and to the left by 60, from 0.7 m above the floor."""
    tilt, turn = math.radians(25.0), math.radians(60.0)
    c, s = math.cos(turn), math.sin(turn)
    down = np.array([[math.cos(tilt), 0.0, math.sin(tilt)], [0.0, 1.0, 0.0], [-math.sin(tilt), 0.0, math.cos(tilt)]])
    pose = np.eye(4)
    pose[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ down
    pose[:3, 3] = [0.3, -0.1, 0.7]
    in_base = np.concatenate([room(0.7), room(0.0, 2.4), room(1.2)])
    points = (in_base - pose[:3, 3]) @ pose[:3, :3]
    scan = cut_of(points, HeightCut(), pose, LidarMount(np.array([0.3, -0.1, turn])))
    assert len(scan.ranges) > 800
    assert on_walls(scan)


@pytest.mark.parametrize(
    ("name", "kind", "unit", "start"),
    [
        ("time", FLOAT32, 1.0, 0.0),
        ("time", FLOAT32, 1.0, -0.1),
        ("t", UINT32, 1e9, 0.0),
        ("timestamp", FLOAT64, 1.0, 1.7e9),
        ("timestamp", FLOAT64, 1e9, 1.7e9),
    ],
)
def test_times_of_points_in_all_units(name: str, kind: int, unit: float, start: float) -> None:
    points = room(0.0)
    times = np.linspace(0.0, 0.09, len(points))
    stamp = 1.7e9
    scan = cut_of(points, times=(name, kind, (times + start) * unit), stamp=stamp)
    assert scan.stamp == pytest.approx(stamp + min(start, 0.0), abs=1e-6)
    assert scan.time_offsets == pytest.approx(times, abs=2e-6)


def test_times_without_a_meaning_are_ignored() -> None:
    points = room(0.0)
    scan = cut_of(points, times=("time", FLOAT32, np.linspace(0.0, 700.0, len(points))))
    assert scan.stamp == 1.0
    assert not scan.time_offsets.any()


def entries(count: int = 3) -> list[Stored]:
    scan = Scan(1.0, np.hypot(*room(0.0)[:, :2].T), np.radians(np.arange(-180.0, 180.0, 0.4)), np.zeros(900), 0.1, 10.0)
    mount = np.array([0.2, 0.0, 0.5])
    return [
        ("/tf_static", TRANSFORMS, 1, ENCODER.transform(0.0, "base_link", "laser", mount)),
        *(("/points", POINT_CLOUD, 10 + k, cloud_of_scan(replace(scan, stamp=1.0 + k))) for k in range(count)),
    ]


@pytest.mark.parametrize("name", ["a.bag", "sqlite3", "mcap"])
def test_clouds_of_a_recording_are_read(tmp_path: Path, write_bag: WriteBag, name: str) -> None:
    source = drivers.open(write_bag(tmp_path / name, entries()))
    first, *others = (message for message in source if isinstance(message, Scan))
    assert len(others) == 2
    assert len(first.ranges) == 900
    assert first.mount == pytest.approx([0.2, 0.0, 0.5])
    assert source.report.interpretations == ["point clouds of /points, cut at the height of the lidar ± 0.1 m"]


def test_scans_are_preferred_and_clouds_can_be_named(tmp_path: Path, write_bag: WriteBag) -> None:
    beams = np.linspace(-1.0, 1.0, 5)
    scan = ENCODER.scan(Scan(1.0, beams + 2.0, beams, np.zeros(5), 0.1, 10.0), "laser")
    path = write_bag(tmp_path / "bag", [*entries(), ("/scan", LASER_SCAN, 20, scan)])
    assert [len(scan.ranges) for scan in drivers.open(path)] == [5]
    clouds = drivers.open(path, LidarSelection("/points", cut_height=0.5, cut_thickness=0.02))
    assert [len(scan.ranges) for scan in clouds] == [900] * 3
    with pytest.raises(RecordingError, match=r"no topic /side .* /points, /scan"):
        list(drivers.open(path, LidarSelection("/side")))
    with pytest.raises(RecordingError, match=r"contains no readable .*no points at a height of 9 m"):
        list(drivers.open(path, LidarSelection("/points", cut_height=9.0)))


def test_damaged_clouds_are_invalid() -> None:
    whole = decode(cloud(room(0.0)), POINT_CLOUD, "cdr")
    for name, value in [("width", 10**9), ("point_step", 3), ("row_step", 10**9), ("fields", []), ("height", 0)]:
        damaged = decode(cloud(room(0.0)), POINT_CLOUD, "cdr")
        object.__setattr__(damaged, name, value)
        with pytest.raises(ValueError, match=r"point|offset|itemsize"):
            scan_of_cloud(damaged, 0, None, LidarMount(), HeightCut())
    assert on_walls(scan_of_cloud(whole, 0, None, LidarMount(), HeightCut()))

"""Fixtures: one short drive as a recording in every supported format."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.recordings.mcap import McapWriter
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import LASER_SCAN, ODOMETRY, POSE, TRANSFORMS, type_store
from drivers.simulation import LidarModel, Simulation
from drivers.timestamps import to_nanoseconds


@pytest.fixture(scope="session")
def drive() -> list[Message]:
    """Three seconds in a room with a lidar of 180 beams that is mounted off-centre and rotated."""
    lidar = LidarModel(beams=180, dropouts=0.05)
    return list(Simulation("room", seed=7, duration=3.0, lidar=lidar, mount=(0.1, -0.05, 0.3)))


def carmen_lines(messages: list[Message]) -> list[str]:
    lines = ["# a log", "PARAM robot_width 0.5 nohost 0.0", "SYNC tag 1 host 0.0"]
    pose = np.zeros(3)
    for message in messages:
        if isinstance(message, Odometry):
            pose = message.pose
            x, y, heading = pose
            lines.append(f"ODOM {x:.6f} {y:.6f} {heading:.6f} 0 0 0 {message.stamp:.6f} host {message.stamp:.6f}")
        elif isinstance(message, Scan):
            ranges = " ".join(f"{81.91 if np.isnan(r) else r:.2f}" for r in message.ranges)
            x, y, heading = pose
            tail = f"{x:.6f} {y:.6f} {heading:.6f} {x:.6f} {y:.6f} {heading:.6f} {message.stamp:.6f} host 0.1"
            lines.append(f"FLASER {len(message.ranges)} {ranges} {tail}")
    return lines


@pytest.fixture(scope="session")
def carmen_text(drive: list[Message]) -> str:
    return "\n".join(carmen_lines(drive)) + "\n"


Stored = tuple[str, str, int, bytes]


def ros_entries(messages: list[Message], encoder: RosEncoder) -> list[Stored]:
    """Return topic, type, time of reception and CDR bytes of a robot's usual topics."""
    entries: list[Stored] = []
    for message in messages:
        received = to_nanoseconds(message.stamp) + 1_000_000
        if isinstance(message, Scan):
            if message.mount is not None and not any(kind == TRANSFORMS for _, kind, _, _ in entries):
                entries.append(
                    (
                        "/tf_static",
                        TRANSFORMS,
                        received,
                        encoder.transform(message.stamp, "base_link", "laser", message.mount),
                    )
                )
            entries.append(("/scan", LASER_SCAN, received, encoder.scan(message, "laser")))
        elif isinstance(message, Odometry):
            entries.append(("/odom", ODOMETRY, received, encoder.odometry(message)))
        else:
            entries.append(("/ground_truth", POSE, received, encoder.ground_truth(message)))
    return entries


def write_bag1(path: Path, entries: list[Stored]) -> None:
    store = type_store("ros1")
    with Writer1(path) as writer:
        connections = {}
        for topic, kind, received, data in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], received, type_store("cdr").cdr_to_ros1(data, kind))


def write_bag2(path: Path, entries: list[Stored], plugin: StoragePlugin) -> None:
    store = type_store("cdr")
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, kind, received, data in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], received, data)


@pytest.fixture(scope="session")
def write_bag() -> Callable[[Path, list[Stored]], Path]:
    """Function that writes a ROS 1 bag, or a ROS 2 bag into a directory, depending on the path's name."""

    def write(path: Path, entries: list[Stored]) -> Path:
        if path.suffix == ".bag":
            write_bag1(path, entries)
        else:
            write_bag2(path, entries, StoragePlugin.MCAP if "mcap" in path.name else StoragePlugin.SQLITE3)
        return path

    return write


@pytest.fixture(scope="session")
def recordings(drive: list[Message], carmen_text: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Arguments for `drivers.open` by kind of source."""
    folder = tmp_path_factory.mktemp("recordings")
    entries = ros_entries(drive, RosEncoder())
    (folder / "drive.clf").write_text(carmen_text)
    (folder / "drive.clf.gz").write_bytes(gzip.compress(carmen_text.encode()))
    (folder / "drive.clf.bz2").write_bytes(bz2.compress(carmen_text.encode()))
    with McapWriter(folder / "drive.mcap") as writer:
        for message in drive:
            writer.write(message)
    write_bag1(folder / "drive.bag", entries)
    write_bag2(folder / "sqlite3", entries, StoragePlugin.SQLITE3)
    write_bag2(folder / "mcap", entries, StoragePlugin.MCAP)
    return {
        "carmen": str(folder / "drive.clf"),
        "carmen-gzip": str(folder / "drive.clf.gz"),
        "carmen-bzip2": str(folder / "drive.clf.bz2"),
        "mcap": str(folder / "drive.mcap"),
        "ros1-bag": str(folder / "drive.bag"),
        "ros2-sqlite3": str(folder / "sqlite3"),
        "ros2-mcap": str(folder / "mcap"),
        "simulation": "sim:room?seed=7&duration=3",
    }


def difference(one: Message, other: Message) -> str | None:
    """Return a description of the first difference of two messages, bit for bit; None if they are equal."""
    if type(one) is not type(other) or one.stamp != other.stamp:
        return f"{one} is not {other}"
    if isinstance(one, Odometry | GroundTruth):
        assert isinstance(other, Odometry | GroundTruth)
        return None if np.array_equal(one.pose, other.pose) else f"pose {one.pose} is not {other.pose}"
    assert isinstance(other, Scan)
    for name in ("ranges", "angles", "time_offsets"):
        if not np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True):
            return f"{name} {getattr(one, name)} is not {getattr(other, name)}"
    if (one.intensities is None) != (other.intensities is None):
        return "intensities"
    if one.intensities is not None and not np.array_equal(one.intensities, other.intensities):
        return f"intensities {one.intensities} are not {other.intensities}"
    if (one.range_min, one.range_max) != (other.range_min, other.range_max):
        return "limits"
    if (one.mount is None) != (other.mount is None):
        return "mount"
    if one.mount is not None and other.mount is not None and not np.array_equal(one.mount, other.mount):
        return f"mount {one.mount} is not {other.mount}"
    return None


@pytest.fixture(scope="session")
def assert_same() -> Callable[[list[Message], list[Message]], None]:
    """Function that fails if two lists of messages are not equal bit for bit."""

    def check(one: list[Message], other: list[Message]) -> None:
        assert len(one) == len(other)
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            found = difference(a, b)
            assert found is None, f"message {i}: {found}"

    return check

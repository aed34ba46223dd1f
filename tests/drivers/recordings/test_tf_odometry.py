"""Odometry that a robot publishes on /tf only is read; recordings contain it on /tf for viewers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import drivers
from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.recordings.mcap import McapWriter
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import LASER_SCAN, ODOMETRY, TRANSFORMS, decode
from drivers.recordings.stored_messages import find_odometry_frames
from drivers.recordings.transforms import TransformTree

from ..conftest import ros_entries

Stored = tuple[str, str, int, bytes]
ENCODER = RosEncoder()


def on_tf(entries: list[Stored], drive: list[Message]) -> list[Stored]:
    """Return the entries with transforms in place of the odometry."""
    readings = iter([message for message in drive if isinstance(message, Odometry)])
    changed = []
    for topic, kind, received, data in entries:
        if kind == ODOMETRY:
            reading = next(readings)
            data = ENCODER.transform(reading.stamp, "odom_combined", "base_link", reading.pose)
            topic, kind = "/tf", TRANSFORMS
        changed.append((topic, kind, received, data))
    return changed


@pytest.mark.parametrize("name", ["a.bag", "sqlite3", "mcap"])
def test_transforms_take_the_place_of_odometry(
    tmp_path: Path, drive: list[Message], write_bag: Callable[[Path, list[Stored]], Path], name: str
) -> None:
    """Also with other transforms, such as those of wheels, and of the map, which must not be mistaken for odometry."""
    others: list[Stored] = [
        ("/tf", TRANSFORMS, received, ENCODER.transform(0.01, parent, child, np.full(3, 0.5)))
        for received in range(20)
        for parent, child in (("map", "odom_combined"), ("base_link", "wheel"))
    ]
    entries = [*others, *on_tf(ros_entries(drive, ENCODER), drive)]
    source = drivers.open(write_bag(tmp_path / name, entries))
    read = list(source)
    expected = [message for message in drive if isinstance(message, Odometry)]
    odometry = [message for message in read if isinstance(message, Odometry)]
    stamps = [message.stamp for message in odometry]
    assert stamps[1:] == [message.stamp for message in expected][1:]  # zero stands for the time of reception
    assert np.array_equal([message.pose for message in odometry], [message.pose for message in expected])
    first = next(message for message in drive if isinstance(message, Scan))
    assert np.array_equal(next(message for message in read if isinstance(message, Scan)).mount, first.mount)
    assert "odometry from the transforms odom_combined -> base_link on /tf" in source.report.interpretations


def test_odometry_moves_the_lidar_and_not_another_frame(
    tmp_path: Path, drive: list[Message], write_bag: Callable[[Path, list[Stored]], Path]
) -> None:
    """As robots of ROS 1 send it: the mount again and again on /tf, and more often where a planner wants to go."""
    entries: list[Stored] = []
    for topic, kind, received, data in on_tf(ros_entries(drive, ENCODER), drive):
        goals = 3 if kind == TRANSFORMS and topic == "/tf" else 0
        goal = ENCODER.transform(0.01, "odom_combined", "goal", np.array([5.0, 6.0, 1.0]))
        entries += [("/tf", TRANSFORMS, received, goal)] * goals
        entries.append(("/tf" if topic == "/tf_static" else topic, kind, received, data))
    read = list(drivers.open(write_bag(tmp_path / "a.bag", entries)))
    expected = [message.pose for message in drive if isinstance(message, Odometry)]
    assert np.array_equal([message.pose for message in read if isinstance(message, Odometry)], expected)
    first = next(message for message in drive if isinstance(message, Scan))
    assert np.array_equal(next(message for message in read if isinstance(message, Scan)).mount, first.mount)


def test_a_lidar_is_not_mounted_on_what_odometry_moves() -> None:
    tree = TransformTree()
    for parent, child in (("base_link", "laser"), ("odom", "base_link"), ("odom", "goal")):
        tree.add(decode(ENCODER.transform(0.01, parent, child, np.full(3, 0.5)), TRANSFORMS, "cdr"))
    assert tree.mount_on("base_link", "laser").pose is not None
    assert tree.mount_on("goal", "laser").pose is None


def tree_of(*headings: float) -> TransformTree:
    """Return the transforms of a robot whose lidar has these headings (radians) one after the other."""
    tree = TransformTree()
    for heading in headings:
        mount = np.array([0.1, 0.1 * abs(heading), heading])
        tree.add(decode(ENCODER.transform(0.01, "base_link", "laser", mount), TRANSFORMS, "cdr"))
    return tree


def test_a_lidar_moves_if_it_has_more_than_two_poses_on_the_robot() -> None:
    """Two programs may state two different poses again and again."""
    assert not tree_of(0.0, 0.0).moves("laser", "base_link")
    assert tree_of(0.0, 0.0).disagreement("laser") is None
    assert not tree_of(0.0, 0.2, 0.0, 0.2).moves("laser", "base_link")
    assert tree_of(0.0, 0.2, 0.0, 0.2).disagreement("laser") == pytest.approx((0.02, 0.2))
    assert tree_of(0.0, 0.2, 0.4).moves("laser", "base_link")
    assert tree_of(0.0, 0.2, 0.4).disagreement("laser") is None


@pytest.mark.parametrize(("degrees", "projected"), [(0.5, False), (20.0, True), (90.0, False)])
def test_only_a_lidar_that_measures_along_the_floor_is_projected(degrees: float, projected: bool) -> None:
    """One that is upright does not, but must not be taken for a level one."""
    _, y, _, w = Rotation.from_euler("y", degrees, degrees=True).as_quat()
    tree, transforms = (
        TransformTree(),
        decode(ENCODER.transform(0.01, "base_link", "laser", np.zeros(3)), TRANSFORMS, "cdr"),
    )
    rotation = transforms.transforms[0].transform.rotation
    turned = replace(transforms.transforms[0].transform, rotation=replace(rotation, y=float(y), w=float(w)))
    tree.add(replace(transforms, transforms=[replace(transforms.transforms[0], transform=turned)]))
    mount = tree.find_mount("laser", "base_link")
    assert mount.tilt == pytest.approx(np.radians(degrees) if degrees > 1.0 else 0.0)
    assert (mount.projection is not None) is projected


def test_a_lidar_with_the_frame_of_the_base_is_mounted_there() -> None:
    tree = TransformTree()
    tree.add(decode(ENCODER.transform(0.01, "odom", "base_link", np.full(3, 0.5)), TRANSFORMS, "cdr"))
    assert tree.find_mount("base_link", "base_link").pose == pytest.approx(np.zeros(3))
    assert tree.find_mount("laser", "base_link").pose is None


def test_recordings_place_the_scans_for_viewers(tmp_path: Path, drive: list[Message]) -> None:
    """The transforms on /tf alone say where the scans of a recording are."""
    path = tmp_path / "drive.mcap"
    with McapWriter(path) as writer:
        for message in drive:
            writer.write(message)
    reader = drivers.open(path)
    transforms = [stored for stored in reader._stored_messages(False) if stored.topic == "/tf"]  # type: ignore[attr-defined]
    assert len(transforms) == sum(isinstance(message, Odometry) for message in drive)
    assert find_odometry_frames(transforms, TransformTree(), "") == ("odom", "base_link")
    kept = [message for message in reader if not isinstance(message, GroundTruth)]
    assert len(kept) == sum(not isinstance(message, GroundTruth) for message in drive)


def test_transforms_without_odometry_are_none(
    tmp_path: Path, write_bag: Callable[[Path, list[Stored]], Path], drive: list[Message]
) -> None:
    scans = [entry for entry in ros_entries(drive, ENCODER) if entry[1] == LASER_SCAN]
    wheel = ("/tf", TRANSFORMS, 1, ENCODER.transform(0.01, "base_link", "wheel", np.zeros(3)))
    read = list(drivers.open(write_bag(tmp_path / "a.bag", [wheel, *scans])))
    assert {type(message) for message in read} == {Scan}

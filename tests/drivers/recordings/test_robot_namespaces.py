"""Of several robots in one recording, odometry, gyroscope and mount are those of the robot whose lidar is read."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Message, Odometry, Scan
from drivers.recordings.robot_namespaces import topics_of_other_robots
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import IMU, LASER_SCAN, ODOMETRY, TRANSFORMS
from drivers.recordings.ros_reader import RosReader
from drivers.source_factory import LidarSelection, open

from ..conftest import Stored, ros_entries

SHIFT = np.array([20.0, -3.0, 1.0])
MOUNTS = {"one": np.array([0.1, 0.0, 0.0]), "two": np.array([-0.2, 0.05, 3.0])}
"""Mounts of the lidars, by robot."""
ENCODER = RosEncoder()


def robot(name: str, drive: list[Message], on_tf: bool) -> list[Stored]:
    """Return the messages of a robot in its namespace, the second one with every third odometry reading only.

    on_tf  odometry is on /tf, with frames that begin with the name of the robot, else in messages whose frames do not
    """
    prefix = f"{name}/" if on_tf else ""
    moved = [
        replace(message, mount=MOUNTS[name])
        if isinstance(message, Scan)
        else replace(message, pose=se2.compose(SHIFT * (name == "two"), message.pose))
        for message in drive
        if isinstance(message, Scan | Odometry)
    ]
    kept = [message for k, message in enumerate(moved) if name == "one" or isinstance(message, Scan) or k % 3 == 0]
    entries: list[Stored] = []
    for message, (topic, kind, received, data) in zip(
        kept, [entry for entry in ros_entries(kept, ENCODER) if entry[0] != "/tf_static"], strict=True
    ):
        if isinstance(message, Scan):
            data = ENCODER.scan(message, f"{prefix}laser")
        elif on_tf:
            data = ENCODER.transform(message.stamp, f"{prefix}odom", f"{prefix}base_link", message.pose)
            topic, kind = "/tf", TRANSFORMS
        entries.append((topic if topic == "/tf" else f"/{name}{topic}", kind, received, data))
    static = "/tf_static" if on_tf else f"/{name}/tf_static"
    mount = ENCODER.transform(drive[0].stamp, f"{prefix}base_link", f"{prefix}laser", MOUNTS[name])
    return [(static, TRANSFORMS, entries[0][2], mount), *entries]


@pytest.mark.parametrize("on_tf", [False, True])
@pytest.mark.parametrize("name", ["one", pytest.param("two", marks=pytest.mark.slow)])
def test_each_robot_is_read_with_its_own_odometry_and_mount(
    tmp_path: Path, drive: list[Message], write_bag: Callable[[Path, list[Stored]], Path], name: str, on_tf: bool
) -> None:
    both = sorted([*robot("one", drive, on_tf), *robot("two", drive, on_tf)], key=lambda entry: entry[2])
    source = open(write_bag(tmp_path / "both", both), LidarSelection(topic=f"/{name}/scan"))
    assert isinstance(source, RosReader)
    alone = open(write_bag(tmp_path / "alone", robot(name, drive, on_tf)))
    read, expected = list(source), list(alone)
    assert len(read) == len(expected)
    for one, other in zip(read, expected, strict=True):
        assert one.stamp == other.stamp
        if isinstance(one, Odometry):
            assert isinstance(other, Odometry)
            np.testing.assert_array_equal(one.pose, other.pose)
        else:
            assert isinstance(one, Scan)
            np.testing.assert_array_equal(one.mount, MOUNTS[name])
    left_out = [text for text in source.report.interpretations if "other robots" in text]
    other_name = "two" if name == "one" else "one"
    assert left_out == (
        [] if on_tf else [f"topics of other robots are left out: /{other_name}/odom, /{other_name}/tf_static"]
    )


@pytest.mark.parametrize(
    ("topics", "lidar", "left_out"),
    [
        pytest.param(
            {LASER_SCAN: ["/front/scan", "/rear/scan"], ODOMETRY: ["/odom"]}, "/rear/scan", set(), id="two lidars"
        ),
        pytest.param(
            {LASER_SCAN: ["/scan", "/camera/scan"], ODOMETRY: ["/odom", "/camera/odom"], IMU: ["/camera/imu"]},
            "/scan",
            {"/camera/odom"},
            id="a camera with the only gyroscope",
        ),
        pytest.param(
            {LASER_SCAN: ["/a/scan", "/b/scan"], ODOMETRY: ["/a/odom", "/b/odom"], TRANSFORMS: ["/tf", "/b/tf_static"]},
            "/a/scan",
            {"/b/odom"},
            id="transforms of one robot only",
        ),
        pytest.param({ODOMETRY: ["/a/odom", "/b/odom"]}, None, set(), id="no lidar"),
    ],
)
def test_only_what_the_robot_has_of_its_own_is_left_out_of_others(
    topics: dict[str, list[str]], lidar: str | None, left_out: set[str]
) -> None:
    counts = {kind: Counter(names) for kind, names in topics.items()}
    assert topics_of_other_robots(counts, lidar) == left_out

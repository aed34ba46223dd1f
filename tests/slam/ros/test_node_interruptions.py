"""`wclm ros` on robots and simulators that begin again, and on lidars that are restarted or upside down."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Floats, Scan
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import LASER_SCAN, TRANSFORMS, LidarMount, decode, planar_pose, scan_of
from drivers.ros2.encoder import GRID, POSE_WITH_COVARIANCE, NodeEncoder
from slam.io.sessions import read_session

from ...memory_link import MemoryLink
from .test_node import (
    MOUNT,
    PATIENCE,
    START,
    Published,
    record_office,
    robot_messages,
    run_node,
    seconds,
)

BREAK = START + 6.0
"""Time at which something happens to the robot, seconds."""
ENCODER = RosEncoder()


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> list[Published]:
    recording = tmp_path_factory.mktemp("robot") / "room.mcap"
    record_office(recording, "sim:office?duration=12")
    return robot_messages(recording)


def poses(link: MemoryLink) -> Floats:
    """Return stamps and poses (n, 4) as the node has published them."""
    messages = [decode(data, POSE_WITH_COVARIANCE, "cdr") for data in link.sent["/pose"]]
    return np.array([[seconds(message.header.stamp), *planar_pose(message.pose.pose)] for message in messages])


@dataclass(frozen=True)
class Normal:
    """An undisturbed drive: poses as published, and the output directory."""

    path: Floats
    out: Path

    def at(self, stamp: float) -> Floats:
        """Return the published pose (3,) nearest to a stamp."""
        return np.asarray(self.path[np.argmin(np.abs(self.path[:, 0] - stamp)), 1:])


@pytest.fixture(scope="module")
def normal(robot: list[Published], tmp_path_factory: pytest.TempPathFactory) -> Normal:
    link, out = MemoryLink(), tmp_path_factory.mktemp("normal") / "out"
    run_node(link, robot, out, {})
    return Normal(poses(link), out)


def run_twice(link: MemoryLink, robot: list[Published], out: Path, options: Sequence[str] = ()) -> None:
    """Drive until BREAK, and then the whole drive."""
    before = [item for item in robot if item.arrival < BREAK]
    output = run_node(link, [*before, *robot], out, {}, options=options)
    assert output.count("the clock was set back; a new run continues the map") == 1


@pytest.mark.slow
def test_a_simulation_that_is_reset_is_mapped_on(robot: list[Published], normal: Normal, tmp_path: Path) -> None:
    """The robot is back at its start, and so are clock and odometry."""
    link, out = MemoryLink(), tmp_path / "out"
    run_twice(link, robot, out)
    path = poses(link)
    resets = np.flatnonzero(np.diff(path[:, 0]) < 0.0)
    assert len(resets) == 1
    for stamp, *pose in path[-20:]:
        assert pose == pytest.approx(normal.at(stamp), abs=0.03)
    session = read_session(out)
    assert session.scans[-1].stamp > BREAK + 10.0
    assert session.first_pose == pytest.approx(np.zeros(3), abs=1e-6)


@pytest.mark.slow
def test_a_bag_that_is_played_again_is_localised_again(robot: list[Published], normal: Normal, tmp_path: Path) -> None:
    link = MemoryLink()
    run_twice(link, robot, tmp_path / "out", ["-p", "mode:=localization", "-p", f"map_file_name:={normal.out}"])
    for stamp, *pose in poses(link)[-20:]:
        assert pose == pytest.approx(normal.at(stamp), abs=0.03)


@pytest.mark.parametrize("parameter", ["map_start_pose:=[0.3, -0.2, 0.1]", "map_start_at_dock:=true"])
def test_the_start_in_a_map_is_a_parameter(
    robot: list[Published], normal: Normal, tmp_path: Path, parameter: str
) -> None:
    link, begin = MemoryLink(), [item for item in robot if item.arrival < START + 1.0]
    options = ["-p", "mode:=localization", "-p", f"map_file_name:={normal.out}", "-p", parameter]
    run_node(link, begin, tmp_path / "out", {}, options=options)
    stamp, *pose = poses(link)[0]
    assert stamp < START + 0.5
    assert pose == pytest.approx(normal.at(stamp), abs=0.03)


def mapped(robot: list[Published], change: Callable[[Any, float], Any]) -> list[Published]:
    """Return the messages with scans as `change` returns them from the message and its arrival; None: left out."""
    changed = []
    for item in robot:
        if item.topic != "/scan":
            changed.append(item)
            continue
        scan = scan_of(decode(item.data, LASER_SCAN, "cdr"), 0, LidarMount())
        if (other := change(scan, item.arrival)) is not None:
            changed.append(replace(item, data=ENCODER.scan(other, "laser")))
    return changed


def test_a_lidar_that_is_restarted_with_other_beams(robot: list[Published], normal: Normal, tmp_path: Path) -> None:
    """For 1.5 s there are no scans, then fewer beams, as of a lidar in another mode."""

    def restarted(scan: Scan, arrival: float) -> Scan | None:
        if arrival < BREAK:
            return scan
        rows = slice(3, -2, 2)
        parts = {name: getattr(scan, name)[rows] for name in ("ranges", "angles", "time_offsets")}
        return replace(scan, **parts) if arrival > BREAK + 1.5 else None

    link = MemoryLink()
    run_node(link, mapped(robot, restarted), tmp_path / "out", {})
    for stamp, *pose in poses(link)[-20:]:
        assert pose == pytest.approx(normal.at(stamp), abs=0.03)


@pytest.mark.slow
def test_a_lidar_upside_down_is_taken_from_its_transform(
    robot: list[Published], normal: Normal, tmp_path: Path
) -> None:
    """Its frame is turned by 180 degrees about the x axis, and its beams run the other way."""

    def mirrored(scan: Scan, _: float) -> Scan:
        return replace(scan, angles=-scan.angles[::-1], ranges=scan.ranges[::-1])

    types = ENCODER.types
    upside_down = types["geometry_msgs/msg/Transform"](
        types["geometry_msgs/msg/Vector3"](MOUNT[0], MOUNT[1], 0.2),
        types["geometry_msgs/msg/Quaternion"](1.0, 0.0, 0.0, 0.0),
    )
    link, messages = MemoryLink(), mapped(robot, mirrored)
    for number, item in enumerate(messages):
        if item.topic == "/tf_static":
            mount = decode(item.data, TRANSFORMS, "cdr")
            stamped = replace(mount.transforms[0], transform=upside_down)
            data = bytes(ENCODER.store.serialize_cdr(types[TRANSFORMS]([stamped]), TRANSFORMS))
            messages[number] = replace(item, data=data)
    run_node(link, messages, tmp_path / "out", {})
    for stamp, *pose in poses(link)[5:]:
        assert pose == pytest.approx(normal.at(stamp), abs=0.03)


def test_reasons_for_which_messages_are_dropped_are_printed_once(robot: list[Published], tmp_path: Path) -> None:
    """A node runs for weeks, so its summary comes too late."""
    start = Published(
        0.0, "/initialpose", POSE_WITH_COVARIANCE, NodeEncoder().pose(0.0, "odom", np.array(MOUNT), np.eye(3))
    )
    messages = [item for item in robot if item.arrival < START + 2.0]
    output = run_node(MemoryLink(), [*messages[:50], start, start, *messages[50:]], tmp_path / "out", {})
    assert output.count("wclm: a message was dropped: initial pose in another frame than the map's") == 1


def test_a_map_that_stays_the_same_is_sent_again(robot: list[Published], tmp_path: Path) -> None:
    """A robot that stands adds nothing to the map; scans that follow the first one that was sent send it again."""
    first = [item for item in robot if item.arrival < START + 1.0]
    scan = next(item for item in reversed(first) if item.topic == "/scan")
    tf = next(item for item in reversed(first) if item.topic == "/tf")
    link = MemoryLink()
    standing = [*first]
    for step in range(1, 40):
        standing += [later(tf, 0.1 * step), later(scan, 0.1 * step)]

    def wait_for_map() -> None:
        with link.changed:
            assert link.changed.wait_for(lambda: link.sent["/map"], PATIENCE)

    calls = {sum(item.topic == "/scan" for item in first) + 20: wait_for_map}
    options = ["-p", "map_update_interval:=0.001", "--log-level", "info"]
    run_node(link, standing, tmp_path / "out", calls, options=options)
    grids = link.sent["/map"]
    assert len(grids) > len(set(grids)) > 0
    assert decode(grids[-1], GRID, "cdr").info.width > 0


def later(item: Published, by: float) -> Published:
    """Return the same measurement as if it was made `by` seconds later."""
    if item.topic == "/scan":
        scan = scan_of(decode(item.data, LASER_SCAN, "cdr"), 0, LidarMount())
        return replace(
            item, arrival=item.arrival + by, data=ENCODER.scan(replace(scan, stamp=scan.stamp + by), "laser")
        )
    stamped = decode(item.data, TRANSFORMS, "cdr").transforms[0]
    pose = np.array([stamped.transform.translation.x, stamped.transform.translation.y, 0.0])
    rotation = stamped.transform.rotation
    pose[2] = 2.0 * np.arctan2(rotation.z, rotation.w)
    frames = stamped.header.frame_id, stamped.child_frame_id
    return replace(item, data=ENCODER.transform(seconds(stamped.header.stamp) + by, *frames, se2.wrap(pose)))

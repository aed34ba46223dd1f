"""`wclm ros` on a simulated robot whose ROS 2 is this process: same results as offline, and what it publishes."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from ruamel.yaml import YAML
from scipy.spatial import KDTree
from typer.testing import CliRunner

import drivers
from drivers import se2
from drivers.messages import Floats, Message, Scan
from drivers.recordings.mcap import McapWriter
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import (
    DIAGNOSTICS,
    LASER_SCAN,
    TRANSFORMS,
    LidarMount,
    decode,
    planar_pose,
    planar_transform,
    scan_of,
    type_store,
)
from drivers.ros2 import receiver, selection
from drivers.ros2.encoder import GRID, MARKERS, POSE_WITH_COVARIANCE
from drivers.ros2.link import STATIC_TRANSFORMS
from drivers.ros2.receiver import RosReceiver
from drivers.simulation import load_world
from slam.cli.app import app
from slam.io.output_dir import KEYFRAMES, MAP, SUMMARY, TRAJECTORY
from slam.io.sessions import read_session
from slam.io.tum import read_tum

from ...memory_link import MemoryLink
from ...replacements import replaced

WORLD = "sim:office?duration=12&lidar=short"
TWO_LIDARS = "sim:office?duration=2.5&lidar=half&mount=0.2,0,0&second_mount=-0.2,0,3"
SCAN_TOPICS = ("/scan", "/scan_2")
START = 1000.0
"""Stamp of the first message, seconds."""
MOUNT = [0.1, 0.0, 0.0]
"""Pose of the lidar on the simulated robot."""
TIMEOUT = 0.5
PATIENCE = 60.0
"""Seconds to wait for the node."""


@dataclass(frozen=True)
class Published:
    """A message of the robot: it arrives at `arrival`, seconds."""

    arrival: float
    topic: str
    msgtype: str
    data: bytes


@dataclass
class NodeRun:
    """A run of the node: what it sent, and its output directory beside that of `wclm run`."""

    link: MemoryLink
    output: str
    responses: dict[str, Any]
    online: Path
    offline: Path
    robot: list[Published]


def record_office(path: Path, world: str = WORLD) -> None:
    """Record a drive whose ranges fit into a LaserScan exactly."""
    encoder = RosEncoder()
    with McapWriter(path) as writer:
        for message in drivers.open(world):
            if isinstance(message, Scan):
                laser_scan = decode(encoder.scan(message, "laser"), LASER_SCAN, "cdr")
                message = replace(scan_of(laser_scan, 0, LidarMount(message.mount)), lidar=message.lidar)
            writer.write(replace(message, stamp=message.stamp + START))


def robot_messages(path: Path) -> list[Published]:
    """Return the messages of a recording in the order in which they would arrive: scans after their sweep."""
    published = []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=True):
            assert schema is not None
            arrival = message.log_time / 1e9
            if schema.name == LASER_SCAN:
                arrival += scan_of(decode(message.data, LASER_SCAN, "cdr"), 0, LidarMount()).duration
            if channel.topic in (*SCAN_TOPICS, "/tf", "/tf_static"):
                published.append(Published(arrival, channel.topic, schema.name, message.data))
    return sorted(published, key=lambda item: item.arrival)


class OpenedReceiver(RosReceiver):
    """Receiver that the test can stop, and that counts scans that were taken or dropped."""

    last: OpenedReceiver

    def __init__(self, *arguments: Any) -> None:
        self.taken, self.asked = 0, threading.Condition()  # scans that were taken before the last message was asked for
        self._taken = 0
        OpenedReceiver.last = self  # before it subscribes: then the robot begins to publish
        super().__init__(*arguments)

    def receive(self, timeout: float) -> Message | None:
        with self.asked:
            self.taken = self._taken
            self.asked.notify_all()
        message = super().receive(timeout)
        self._taken += isinstance(message, Scan)
        return message

    def begin_again(self) -> None:
        self._taken += self._waiting
        super().begin_again()

    def _put(self, message: Message) -> bool:
        appended = super()._put(message)
        self._taken += isinstance(message, Scan) and not appended
        return appended


def feed(link: MemoryLink, robot: list[Published], calls: dict[int, Callable[[], None]], patience: float) -> None:
    """Publish the robot's messages as fast as the node processes its scans, then end the run.

    calls     called after as many scans
    patience  seconds to wait for the node; it takes no scan while it begins another run
    """
    puts = {item.topic: link.publish(item.topic, item.msgtype, STATIC_TRANSFORMS) for item in robot}
    with link.changed:
        link.changed.wait_for(lambda: "/scan" in link.received, PATIENCE)
    try:
        scans = 0
        for item in robot:
            puts[item.topic](item.data)
            if item.topic not in SCAN_TOPICS:
                continue
            scans += 1
            opened = OpenedReceiver.last
            with opened.asked:
                opened.asked.wait_for(lambda opened=opened, wanted=scans: opened.taken >= wanted, patience)
            if item.topic == "/scan" and scans in calls:
                calls[scans]()
    finally:  # else the node would wait for ever if a call fails
        OpenedReceiver.last.stop()


def run_node(
    link: MemoryLink,
    robot: list[Published],
    out: Path,
    calls: dict[int, Callable[[], None]],
    patience: float = PATIENCE,
    options: Sequence[str] = (),
) -> str:
    """Run `wclm ros` with `options` on the robot's messages; return what it printed."""
    parameters = out.with_suffix(".yaml")
    parameters.write_text(
        "slam_toolbox:\n  ros__parameters:\n    base_frame: base_link\n    map_update_interval: 0.2\n"
        f"    transform_timeout: {TIMEOUT}\n    solver_plugin: solver_plugins::CeresSolver\n"
    )
    feeder = threading.Thread(target=feed, args=(link, robot, calls, patience), daemon=True)
    with (
        replaced(selection, "open_link", lambda names, backend: link),
        replaced(receiver, "RosReceiver", OpenedReceiver),
    ):
        feeder.start()
        arguments = ["--out", str(out), "--no-review", "--ros-args", "--params-file", str(parameters), *options]
        result = CliRunner().invoke(app, ["ros", *arguments])
    assert result.exit_code == 0, result.output
    feeder.join(PATIENCE)
    return result.output


@pytest.fixture(scope="module")
def node_run(tmp_path_factory: pytest.TempPathFactory) -> NodeRun:
    folder = tmp_path_factory.mktemp("node")
    recording = folder / "office.mcap"
    record_office(recording)
    arguments = ["run", str(recording), "--out", str(folder / "offline"), "--no-review"]
    offline = CliRunner().invoke(app, arguments)
    assert offline.exit_code == 0, offline.output
    link, responses = MemoryLink(), {}

    def call_services() -> None:
        service = "/slam_toolbox/"
        responses["switch interval"] = sys.getswitchinterval()
        responses["grid"] = link.call(f"{service}dynamic_map").map
        name = type_store("cdr").types["std_msgs/msg/String"](str(folder / "picture"))
        responses["save"] = link.call(f"{service}save_map", name=name).result
        responses["paused"] = [link.call(f"{service}pause_new_measurements").status for _ in range(2)]

    robot = robot_messages(recording)
    output = run_node(link, robot, folder / "online", {40: call_services})
    return NodeRun(link, output, responses, folder / "online", folder / "offline", robot)


def sent(run: NodeRun, topic: str, msgtype: str) -> list[Any]:
    return [decode(data, msgtype, "cdr") for data in run.link.sent[topic]]


def seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


def test_results_are_those_of_the_recording_byte_for_byte(node_run: NodeRun) -> None:
    for name in (TRAJECTORY, MAP, KEYFRAMES):
        assert (node_run.online / name).read_bytes() == (node_run.offline / name).read_bytes()


def test_scans_that_are_processed_delay_poses_little(node_run: NodeRun) -> None:
    assert node_run.responses["switch interval"] < 1e-3 < sys.getswitchinterval()


def test_services_answer(node_run: NodeRun) -> None:
    grid = node_run.responses["grid"]
    assert grid.info.width * grid.info.height == len(grid.data) > 100
    assert node_run.responses["paused"] == [True, False]
    assert node_run.responses["save"] == 0
    assert {path.name for path in node_run.online.parent.glob("picture.*")} == {"picture.pgm", "picture.yaml"}


def test_a_run_is_saved_continued_discarded_and_begun_in_a_map(node_run: NodeRun, tmp_path: Path) -> None:
    link, saved, results = MemoryLink(), tmp_path / "saved", []
    robot = [item for item in node_run.robot if item.arrival < START + 8.0]

    def save() -> None:
        results.append(link.call("/slam_toolbox/serialize_map", filename=str(saved)).result)
        results.append(link.call("/slam_toolbox/serialize_map", filename="").result)

    def begin_in_map() -> None:
        link.call("/slam_toolbox/deserialize_map", filename=str(tmp_path / "nothing"), match_type=1)
        link.call("/slam_toolbox/deserialize_map", filename=str(saved), match_type=3)
        results.append(link.call("/slam_toolbox/serialize_map", filename=str(tmp_path / "unchanged")).result)

    def reset() -> None:
        results.append(link.call("/slam_toolbox/reset", pause_new_measurements=False).result)

    output = run_node(link, robot, tmp_path / "end", {10: save, 15: begin_in_map, 20: reset}, patience=0.02)
    assert results == [0, 255, 255, 0]
    assert f"wclm: deserialize_map: {tmp_path / 'nothing'}: no such directory" in output
    assert not (tmp_path / "unchanged").exists()
    assert output.count("the map is discarded; a new run begins") == 2
    whole = read_tum(node_run.online / TRAJECTORY)
    first = read_tum(saved / TRAJECTORY)
    assert first.stamps[-1] < START + 2.5
    assert first.poses == pytest.approx(whole.poses[: len(first.poses)], abs=0.02)
    scans = [item for item in robot if item.topic == "/scan"]
    last = read_tum(tmp_path / "end" / TRAJECTORY)
    assert last.stamps[0] > scans[19].arrival - 1.0


def test_the_mode_changes_while_the_node_runs(node_run: NodeRun, tmp_path: Path) -> None:
    """The map gets no keyframes in between, and no scan waits: the path has no gap."""
    link, out, results = MemoryLink(), tmp_path / "out", []

    def set_mode(*, frozen: bool) -> None:
        results.append(link.call("/slam_toolbox/set_localization_mode", data=frozen).success)

    calls = {
        20: lambda: set_mode(frozen=True),
        30: lambda: set_mode(frozen=True),
        50: lambda: set_mode(frozen=False),
    }
    output = run_node(link, node_run.robot, out, calls)
    assert results == [True, True, True]
    assert output.count("the map is only localised in from now on") == 2
    assert output.count("the map is extended from now on") == 1
    scans = [item.arrival for item in node_run.robot if item.topic == "/scan"]
    keyframes = np.loadtxt(out / KEYFRAMES, delimiter=",", skiprows=1, usecols=0)
    assert not ((keyframes > scans[20]) & (keyframes < scans[49] - 0.1)).any()
    assert (keyframes > scans[50]).any()
    path, whole = read_tum(out / TRAJECTORY), read_tum(node_run.online / TRAJECTORY)
    np.testing.assert_array_equal(path.stamps, whole.stamps)
    assert path.poses == pytest.approx(whole.poses, abs=0.02)
    modes = {value.value for message in sent_by(link) for value in message.status[0].values if value.key == "mode"}
    assert modes == {"mapping", "localization"}


def sent_by(link: MemoryLink) -> list[Any]:
    return [decode(data, DIAGNOSTICS, "cdr") for data in link.sent["/diagnostics"]]


@pytest.mark.slow
def test_a_map_that_is_only_localised_in_is_saved_and_stays_so(node_run: NodeRun, tmp_path: Path) -> None:
    link, out, results = MemoryLink(), tmp_path / "out", []

    def save() -> None:
        results.append(link.call("/slam_toolbox/serialize_map", filename=str(tmp_path / "saved")).result)

    robot = [item for item in node_run.robot if item.arrival < START + 6.0]
    calls = {15: lambda: link.call("/slam_toolbox/set_localization_mode", data=True), 20: save}
    run_node(link, robot, out, calls, patience=0.05)
    assert results == [0]
    scans = [item.arrival for item in robot if item.topic == "/scan"]
    for place in (tmp_path / "saved", out):
        assert np.loadtxt(place / KEYFRAMES, delimiter=",", skiprows=1, usecols=0).max() < scans[15]
    assert read_session(out).slam_state.mapper.keyframe_count
    assert read_tum(out / TRAJECTORY).stamps[-1] > scans[-1] - 1.0


def test_poses_are_published_with_odometry_and_their_covariance(node_run: NodeRun) -> None:
    poses = sent(node_run, "/pose", POSE_WITH_COVARIANCE)
    stamps = np.array([seconds(message.header.stamp) for message in poses])
    assert np.diff(stamps).max() < 0.05  # of the simulated odometry; scans come every 0.1 s
    final = read_tum(node_run.online / TRAJECTORY)
    for message, stamp in list(zip(poses, stamps, strict=True))[5:]:
        at = int(np.argmin(np.abs(final.stamps - stamp)))
        assert final.stamps[at] == pytest.approx(stamp, abs=1e-6)
        assert planar_pose(message.pose.pose) == pytest.approx(final.poses[at], abs=0.05)
        variances = np.diag(message.pose.covariance.reshape(6, 6))
        assert (variances[[0, 1, 5]] > 0.0).all()
        assert message.header.frame_id == "map"


def test_transforms_place_the_robot_where_it_is_and_are_ahead_of_time(node_run: NodeRun) -> None:
    moving = [decode(item.data, TRANSFORMS, "cdr").transforms[0] for item in node_run.robot if item.topic == "/tf"]
    by_stamp = {seconds(item.header.stamp): planar_transform(item.transform) for item in moving}
    ahead = [item.transforms[0] for item in sent(node_run, "/tf", TRANSFORMS)]
    ahead = [item for item in ahead if item.header.frame_id == "map"]
    stamps = [seconds(item.header.stamp) for item in ahead]
    assert (np.diff(stamps) > 0.0).all()
    final = read_tum(node_run.online / TRAJECTORY)
    for item, stamp in list(zip(ahead, stamps, strict=True))[5:]:
        measured = min(by_stamp, key=lambda other: abs(other + TIMEOUT - stamp))
        assert measured + TIMEOUT == pytest.approx(stamp, abs=1e-6)
        pose = se2.compose(planar_transform(item.transform), by_stamp[measured])
        at = int(np.argmin(np.abs(final.stamps - measured)))
        assert pose == pytest.approx(final.poses[at], abs=0.05)
        assert item.child_frame_id == "odom"


def test_grid_shows_the_room(node_run: NodeRun) -> None:
    """The last grid has the walls of the map at occupied cells, and the driven path on free ones."""
    grid = sent(node_run, "/map", GRID)[-1]
    info = grid.info
    assert sent(node_run, "/map_metadata", "nav_msgs/msg/MapMetaData")[-1] == info
    cells = grid.data.reshape(info.height, info.width)
    origin = np.array([info.origin.position.x, info.origin.position.y])
    keyframes = np.loadtxt(node_run.online / KEYFRAMES, delimiter=",", skiprows=1, usecols=(1, 2, 3))
    lidar = se2.compose(keyframes, MOUNT)[:, :2]
    columns, rows = np.floor((lidar - origin) / info.resolution).astype(int).T
    assert (cells[rows, columns] == 0).all()
    assert info.resolution == pytest.approx(0.05)
    assert (cells == 100).sum() > 100


def test_state_and_markers_are_published(node_run: NodeRun) -> None:
    states = sent(node_run, "/diagnostics", DIAGNOSTICS)
    assert {status.message for message in states for status in message.status} == {"OK"}
    assert {status.level for message in states for status in message.status} == {0}
    markers = sent(node_run, "/slam_toolbox/graph_visualization", MARKERS)[-1].markers
    points = {marker.ns: len(marker.points) for marker in markers}
    assert points["walls"] > 10
    assert points["corners"] > 3
    assert points["path"] > 10


def test_one_line_says_what_is_used(node_run: NodeRun) -> None:
    lines = node_run.output.splitlines()
    assert "wclm: node /slam_toolbox by memory" in lines
    assert "wclm: parameters without a counterpart are ignored: solver_plugin" in lines
    assert node_run.link.closed


@pytest.mark.slow
def test_two_lidars_as_in_a_recording(tmp_path: Path) -> None:
    recording, link = tmp_path / "drive.mcap", MemoryLink()
    record_office(recording, TWO_LIDARS)
    settings = ["--set", "lidar.topic=/scan", "--set", "second_lidar.topic=/scan_2"]
    arguments = ["run", str(recording), "--out", str(tmp_path / "offline"), "--no-review", *settings]
    offline = CliRunner().invoke(app, arguments)
    assert offline.exit_code == 0, offline.output
    run_node(link, robot_messages(recording), tmp_path / "online", {}, options=["-p", "second_scan_topic:=/scan_2"])
    for name in (TRAJECTORY, MAP, KEYFRAMES):
        assert (tmp_path / "online" / name).read_bytes() == (tmp_path / "offline" / name).read_bytes()
    assert json.loads((tmp_path / "online" / SUMMARY).read_text())["slam"]["second_lidar"]["joined"] == 24


@pytest.mark.slow
def test_times_of_beams_are_set_as_for_a_recording(node_run: NodeRun, tmp_path: Path) -> None:
    recording, link = node_run.offline.parent / "office.mcap", MemoryLink()
    settings = ["--set", "lidar.turn_period=0.05", "--set", "lidar.beam_order=reversed"]
    arguments = ["run", str(recording), "--out", str(tmp_path / "offline"), "--no-review", *settings]
    offline = CliRunner().invoke(app, arguments)
    assert offline.exit_code == 0, offline.output
    run_node(link, robot_messages(recording), tmp_path / "online", {}, options=settings)
    trajectory = (tmp_path / "online" / TRAJECTORY).read_bytes()
    assert trajectory == (tmp_path / "offline" / TRAJECTORY).read_bytes()
    assert trajectory != (node_run.offline / TRAJECTORY).read_bytes()


def test_a_plan_helps_mapping_and_gives_the_frame(tmp_path: Path) -> None:
    recording, plan, link = tmp_path / "drive.mcap", tmp_path / "room.geojson", MemoryLink()
    walls = load_world("room").segments.reshape(-1, 2, 2)
    shifted = walls + np.array([20.0, 10.0])
    plan.write_text(json.dumps({"type": "MultiLineString", "coordinates": shifted.tolist(), "units": "m"}))
    record_office(recording, "sim:room?duration=10&lidar=short")
    options = ["--plan", str(plan), "--start", "21,11,0"]
    run_node(link, robot_messages(recording), tmp_path / "online", {}, options=options)
    found = json.loads((tmp_path / "online" / SUMMARY).read_text())["plan"]
    assert (found["file"], found["recognised"]) == ("room.geojson", True)
    grid = decode(link.sent["/map"][-1], GRID, "cdr")
    corner = np.array([grid.info.origin.position.x, grid.info.origin.position.y])
    assert corner == pytest.approx(shifted.min(axis=(0, 1)), abs=0.2)
    poses = [decode(data, POSE_WITH_COVARIANCE, "cdr").pose.pose.position for data in link.sent["/pose"]]
    assert poses[-1].x > 20.0


def test_a_run_without_a_recording_has_a_grid_map(node_run: NodeRun, tmp_path: Path) -> None:
    """It is drawn from fewer points than that of the recording, and shows the same walls."""
    walls = []
    for folder in (node_run.online, node_run.offline):
        file = tmp_path / folder.name / "grid.pgm"
        file.parent.mkdir()
        result = CliRunner().invoke(app, ["map", str(folder), "--format", "pgm", "--out", str(file)])
        assert result.exit_code == 0, result.output
        assert ("the run was not recorded" in result.output) == (folder == node_run.online)
        grid = read_grid(file.with_suffix(".yaml"))
        walls.append(grid)
    few, all_of_them = walls
    assert 0.7 * len(all_of_them) < len(few) < 1.1 * len(all_of_them)
    distances, _ = KDTree(all_of_them).query(few)
    assert np.mean(distances < 0.08) > 0.97


def read_grid(file: Path) -> Floats:
    """Return the centres (n, 2) of the occupied cells of a grid map, metres."""
    settings = YAML(typ="safe").load(file.read_text())
    content = (file.parent / settings["image"]).read_bytes()
    columns, rows = map(int, content.split(b"\n", 2)[1].split())
    pixels = np.frombuffer(content[-rows * columns :], dtype=np.uint8).reshape(rows, columns)[::-1]
    occupied = np.argwhere(pixels == 0)[:, ::-1]
    return np.asarray(settings["origin"][:2] + settings["resolution"] * (occupied + 0.5))

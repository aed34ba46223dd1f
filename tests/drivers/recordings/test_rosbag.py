"""Reading ROS recordings of other robots: choice of topics, lidar mounts, direction of rotation."""

from __future__ import annotations

import math
import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Writer
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import drivers
from drivers import Message, Odometry, RecordingError, Scan
from drivers.messages import YawRate
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import (
    IMU,
    LASER_SCAN,
    ODOMETRY,
    TRANSFORMS,
    LidarMount,
    decode,
    planar_pose,
    scan_of,
    type_store,
)
from drivers.recordings.rosbag import BagReader
from drivers.recordings.transforms import TransformTree
from drivers.source_factory import LidarSelection
from slam.cli.app import app
from slam.cli.console import EXIT_USER_ERROR

Stored = tuple[str, str, int, bytes]
WriteBag = Callable[[Path, list[Stored]], Path]
STORE = type_store("cdr")
TYPES: dict[str, Any] = dict(STORE.types)


def header(stamp: int, frame: str) -> Any:
    time = TYPES["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
    return TYPES["std_msgs/msg/Header"](time, frame)


def laser_scan(
    stamp: int, ranges: list[float], received: int = 5, topic: str = "/scan", frame: str = "laser", **fields: float
) -> Stored:
    values = {"angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.5, "time_increment": 0.001, "scan_time": 0.1}
    values |= {"range_min": 0.1, "range_max": 10.0} | fields
    measured = np.array(ranges, dtype=np.float32)
    message = TYPES[LASER_SCAN](header(stamp, frame), ranges=measured, intensities=measured[:0], **values)
    return topic, LASER_SCAN, received, bytes(STORE.serialize_cdr(message, LASER_SCAN))


def transform(
    parent: str, child: str, at: tuple[float, ...], turn: tuple[float, ...], topic: str = "/tf_static"
) -> Stored:
    t = TYPES["geometry_msgs/msg/Transform"](
        TYPES["geometry_msgs/msg/Vector3"](*at), TYPES["geometry_msgs/msg/Quaternion"](*turn)
    )
    stamped = TYPES["geometry_msgs/msg/TransformStamped"](header(1, parent), child, t)
    message = TYPES[TRANSFORMS]([stamped])
    return topic, TRANSFORMS, 1, bytes(STORE.serialize_cdr(message, TRANSFORMS))


UPRIGHT = (0.0, 0.0, 0.0, 1.0)
ROLLED_OVER = (1.0, 0.0, 0.0, 0.0)
QUARTER_LEFT = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))


@pytest.fixture(params=["a.bag", "sqlite3", "mcap"])
def read(
    request: pytest.FixtureRequest, tmp_path: Path, write_bag: WriteBag
) -> Callable[[list[Stored]], list[Message]]:
    return lambda entries: list(drivers.open(write_bag(tmp_path / request.param, entries)))


Read = Callable[[list[Stored]], list[Message]]


def only_scan(messages: list[Message]) -> Scan:
    (scan,) = messages
    assert isinstance(scan, Scan)
    return scan


def test_scan_is_converted(read: Read) -> None:
    scan = only_scan(read([laser_scan(2_500_000_000, [1.0, 0.05, np.nan, np.inf, 10.0])]))
    assert scan.stamp == 2.5
    assert np.isnan(scan.ranges).tolist() == [False, True, True, True, True]
    assert scan.angles == pytest.approx([-1, -0.5, 0, 0.5, 1])
    assert scan.time_offsets == pytest.approx([0, 0.001, 0.002, 0.003, 0.004])
    assert scan.mount is None


def test_clockwise_scan_is_reversed(read: Read) -> None:
    scan = only_scan(read([laser_scan(1, [1, 2, 3, 4, 5], angle_min=1.0, angle_max=-1.0, angle_increment=-0.5)]))
    assert scan.angles == pytest.approx([-1, -0.5, 0, 0.5, 1])
    assert scan.ranges.tolist() == [5, 4, 3, 2, 1]
    assert scan.time_offsets[0] == pytest.approx(0.004)


def test_zero_stamp_is_replaced_by_the_time_of_reception(read: Read) -> None:
    assert only_scan(read([laser_scan(0, [1.0, 2.0], received=3 * 10**9)])).stamp == 3.0


@pytest.mark.parametrize("behind", [0, 150])
def test_stamps_that_stand_still_are_replaced_by_the_times_of_reception(
    tmp_path: Path, write_bag: WriteBag, behind: int
) -> None:
    """As a simulator sends odometry; the clock of the lidar may be that of the recorder, or seconds `behind` it."""
    encoder, entries = RosEncoder(), list[Stored]()
    for i in range(30):
        received = (200 * 10 + i) * 10**8
        reading = Odometry(200.0, np.array([0.1 * i, 0.0, 0.0]))
        entries.append(("/odom", ODOMETRY, received, encoder.odometry(reading)))
        entries.append(laser_scan(received - behind * 10**9, [1.0, 2.0], received=received))
    source = drivers.open(write_bag(tmp_path / "a.bag", entries))
    stamps = [message.stamp for message in source if isinstance(message, Odometry)]
    np.testing.assert_allclose(stamps, 200.0 - behind + 0.1 * np.arange(30), atol=1e-6)
    assert "stamps of /odom stand still: the times of reception are taken" in source.report.interpretations


def test_missing_range_limits_mean_no_limits(read: Read) -> None:
    scan = only_scan(read([laser_scan(1, [1.0, 50.0, 0.0], range_min=0.0, range_max=0.0)]))
    assert scan.range_max == math.inf
    assert np.isnan(scan.ranges).tolist() == [False, False, True]


def test_scattered_values_of_no_returns_become_nan(read: Read) -> None:
    walls = np.random.default_rng(0).uniform(1.0, 5.0, (40, 8)).astype(np.float32)
    walls[::2, :3], walls[1::2, 5:] = 8.183, 8.191
    scans = read([laser_scan(k + 1, row.tolist(), received=k + 1) for k, row in enumerate(walls)])
    for scan, row in zip(scans, walls, strict=True):
        assert isinstance(scan, Scan)
        np.testing.assert_array_equal(np.isnan(scan.ranges), row > 8.0)


def test_mount_from_a_chain_of_transforms(read: Read) -> None:
    entries = [
        transform("base_footprint", "base_link", (0, 0, 0.1), UPRIGHT),
        transform("base_link", "mast", (0.2, 0.1, 0.5), QUARTER_LEFT),
        transform("mast", "laser", (0.1, 0.0, 0.0), QUARTER_LEFT),
        laser_scan(1, [1.0, 2.0]),
    ]
    mount = only_scan(read(entries)).mount
    assert mount == pytest.approx([0.2, 0.2, -math.pi])


def test_scan_of_an_upside_down_lidar_is_reversed(read: Read) -> None:
    entries = [
        transform("base_link", "laser", (0.2, 0.1, 0), ROLLED_OVER),
        laser_scan(1, [1, 2, 3, 4, 5], angle_min=-0.5),
    ]
    scan = only_scan(read(entries))
    assert scan.mount == pytest.approx([0.2, 0.1, 0.0])
    assert scan.angles == pytest.approx([-1.5, -1, -0.5, 0, 0.5])
    assert scan.ranges.tolist() == [5, 4, 3, 2, 1]


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 20.0), (-15.0, 10.0), (170.0, 5.0)])
def test_walls_are_straight_and_in_place_for_a_tilted_lidar(read: Read, roll: float, pitch: float) -> None:
    """A vertical wall two metres ahead, measured in a plane that is not horizontal."""
    rotation = Rotation.from_euler("xyz", [roll, pitch, 30.0], degrees=True)
    angles = np.arange(-170, 171, 10) * math.pi / 180.0
    ahead = rotation.apply(np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)]))[:, 0]
    ranges = np.where(ahead > 0.2, 2.0 / np.maximum(ahead, 0.2), 0.0)
    entries = [
        transform("base_link", "laser", (0.1, 0.0, 0.0), tuple(rotation.as_quat())),
        laser_scan(1, ranges.tolist(), angle_min=float(angles[0]), angle_increment=math.radians(10.0)),
    ]
    scan = only_scan(read(entries))
    assert scan.mount is not None
    assert np.all(np.diff(scan.angles) > 0.0)
    seen = np.isfinite(scan.ranges)
    assert seen.sum() > 8
    directions = scan.angles[seen] + scan.mount[2]
    np.testing.assert_allclose(scan.ranges[seen] * np.cos(directions), 2.0, atol=1e-5)


def test_a_lidar_that_is_not_level_is_named(tmp_path: Path, write_bag: WriteBag) -> None:
    rolled = tuple(Rotation.from_euler("xyz", [190.0, 0.0, 0.0], degrees=True).as_quat())
    entries = [transform("base_link", "laser", (0.1, 0.0, 0.0), rolled), laser_scan(1, [1.0, 2.0])]
    recording = drivers.open(write_bag(tmp_path / "a.bag", entries))
    only_scan(list(recording))
    assert recording.report.interpretations == [
        "laser is upside down by its transform: scans are mirrored",
        "laser is tilted by 10.0 degrees by its transform: scans are projected onto a horizontal plane",
    ]


@pytest.mark.parametrize(("tilts", "chosen"), [(True, "/level"), (False, "/tilting")])
def test_scans_of_a_lidar_that_a_motor_tilts_are_not_preferred(
    tmp_path: Path, write_bag: WriteBag, tilts: bool, chosen: str
) -> None:
    """They have more returns, but are not measured in one plane."""
    entries = []
    for i in range(40):
        angle = 0.3 * math.sin(0.4 * i) if tilts else 0.0
        entries += [
            transform(
                "base_link", "laser", (0.1, 0.0, 0.3), (0.0, math.sin(angle / 2), 0.0, math.cos(angle / 2)), "/tf"
            ),
            laser_scan(10**9 + i * 10**8, [1.0, 2.0, 3.0, 4.0], topic="/tilting"),
            laser_scan(10**9 + i * 10**8, [1.0, 2.0], topic="/level", frame="level"),
        ]
    entries.append(transform("base_link", "level", (0.2, 0.0, 0.0), UPRIGHT))
    source = drivers.open(write_bag(tmp_path / "a.bag", entries))
    assert len(list(source)) == 40
    assert source.report.scan_topic == chosen
    named = drivers.open(tmp_path / "a.bag", LidarSelection("/tilting"))
    assert len(list(named)) == 40
    assert ("laser moves on the robot by its transforms" in "".join(named.report.doubts)) == tilts


def test_mount_from_repeated_transforms(read: Read) -> None:
    entries = [transform("/base_link", "/laser", (0.3, 0, 0), UPRIGHT, topic="/tf"), laser_scan(1, [1.0, 2.0])]
    assert only_scan(read(entries)).mount == pytest.approx([0.3, 0, 0])


def test_mount_from_fixed_and_repeated_transforms(read: Read) -> None:
    entries = [
        transform("base_link", "mast", (0.3, 0, 0), UPRIGHT),
        transform("mast", "laser", (0.1, 0, 0), UPRIGHT, topic="/tf"),
        transform("odom", "base_link", (7.0, 0, 0), QUARTER_LEFT, topic="/tf"),
        laser_scan(1, [1.0, 2.0]),
    ]
    odometry, scan = read(entries)  # the transform of the base is odometry, and not part of the mount
    assert isinstance(odometry, Odometry)
    assert only_scan([scan]).mount == pytest.approx([0.4, 0, 0])


def test_damaged_transform_leaves_the_mount_unknown(read: Read) -> None:
    entries = [transform("base_link", "laser", (0.3, 0, 0), (0.0, 0.0, 0.0, 0.0)), laser_scan(1, [1.0, 2.0])]
    assert only_scan(read(entries)).mount is None


def test_topic_with_the_most_messages_is_read(tmp_path: Path, write_bag: WriteBag) -> None:
    entries = [laser_scan(i, [1.0, 2.0], topic="/front") for i in range(1, 4)]
    entries += [laser_scan(4, [1.0, 2.0, 3.0], topic="/rear")]
    path = write_bag(tmp_path / "bag", entries)
    assert len(list(BagReader(path))) == 3
    assert len(list(BagReader(path, scan_topic="/rear"))) == 1
    with pytest.raises(RecordingError, match=r"no topic /side .* /front, /rear"):
        list(BagReader(path, scan_topic="/side"))


OTHER = "; odometry.topic names another topic"


@pytest.mark.parametrize(
    ("topics", "chosen", "stated"),
    [
        (["/odom"], "/odom", None),
        (["/odom"] * 2 + ["/odometry/filtered"] * 3, "/odometry/filtered", "3 messages (/odom: 2)" + OTHER),
        (["/base_pose_ground_truth"] * 3 + ["/odom"] * 2, "/odom", "2 messages (/base_pose_ground_truth: 3)" + OTHER),
        (["/base_pose_ground_truth"] * 3, "/base_pose_ground_truth", "3 messages, true poses by its name"),
    ],
)
def test_measured_odometry_is_preferred_and_a_choice_is_stated(
    tmp_path: Path, write_bag: WriteBag, topics: list[str], chosen: str, stated: str | None
) -> None:
    encoder = RosEncoder()
    odometry = [encoder.odometry(Odometry(1.0 + 0.1 * k, np.zeros(3))) for k in range(len(topics))]
    entries = [(topic, ODOMETRY, k, data) for k, (topic, data) in enumerate(zip(topics, odometry, strict=True), 1)]
    source = BagReader(write_bag(tmp_path / "bag", entries))
    assert len(list(source)) == topics.count(chosen)
    assert source.report.odometry_topic == chosen
    assert source.report.interpretations == ([] if stated is None else [f"odometry of {chosen}: {stated}"])


def test_the_topic_of_the_odometry_can_be_named(tmp_path: Path, write_bag: WriteBag) -> None:
    encoder, topics = RosEncoder(), ["/odom"] * 2 + ["/visual"] * 3
    odometry = [encoder.odometry(Odometry(1.0 + 0.1 * k, np.zeros(3))) for k in range(len(topics))]
    entries = [(topic, ODOMETRY, k, data) for k, (topic, data) in enumerate(zip(topics, odometry, strict=True), 1)]
    path = write_bag(tmp_path / "bag", entries)
    source = drivers.open(path, odometry_topic="/odom")
    assert len(list(source)) == 2
    assert source.report.interpretations == ["odometry of /odom: 2 messages (/visual: 3)"]
    with pytest.raises(RecordingError, match=r"no topic /wheels .* /odom, /visual"):
        list(drivers.open(path, odometry_topic="/wheels"))
    (tmp_path / "a.clf").write_text("ODOM 0 0 0 0 0 0 1.0 host 0.0\n")
    for other in (tmp_path / "a.clf", "sim:room"):
        with pytest.raises(RecordingError, match="has no topics, so none is named /odom"):
            drivers.open(other, odometry_topic="/odom")


def test_bad_messages_are_skipped_and_numbered(tmp_path: Path, write_bag: WriteBag) -> None:
    encoder = RosEncoder()
    odometry = encoder.odometry(Odometry(1.0, np.zeros(3)))
    entries: list[Stored] = [
        ("/odom", ODOMETRY, 1, odometry),
        ("/odom", ODOMETRY, 2, odometry[:40]),
        ("/odom", ODOMETRY, 3, encoder.odometry(Odometry(1.1, np.array([np.nan, 0.0, 0.0])))),
        laser_scan(10**9, [], received=4),
        laser_scan(10**9, [1.0, 2.0], received=5, angle_increment=math.nan),
        laser_scan(10**9, [1.0, 2.0], received=6, angle_increment=0.0),
    ]
    source = BagReader(write_bag(tmp_path / "bag", entries))
    assert len(list(source)) == 1
    assert source.report.skipped == 5
    assert source.report.first == f"{source.path}:2: {ODOMETRY} cannot be decoded"
    assert set(source.report.reasons) >= {"no beams", "angles are invalid", "pose is not finite"}


def test_bag_without_scans_and_odometry_is_an_error(tmp_path: Path, write_bag: WriteBag) -> None:
    path = write_bag(tmp_path / "bag", [transform("base_link", "laser", (0, 0, 0), UPRIGHT)])
    with pytest.raises(RecordingError, match=r"contains no readable .*; its topics are /tf_static \(tf2_msgs/msg/TFM"):
        list(BagReader(path))


def test_bag_with_a_gyroscope_alone_is_an_error(tmp_path: Path, write_bag: WriteBag) -> None:
    rate = RosEncoder().yaw_rate(YawRate(1.0, 0.1))
    path = write_bag(tmp_path / "bag", [("/imu", IMU, 10**9, rate)])
    with pytest.raises(RecordingError, match=r"contains no readable .*; its topics are /imu \(sensor_msgs/msg/Imu\)"):
        list(BagReader(path))


def test_a_topic_of_scans_without_a_message_is_named_so(tmp_path: Path) -> None:
    odometry = RosEncoder().odometry(Odometry(1.0, np.zeros(3)))
    with Writer(tmp_path / "bag", version=9) as writer:
        writer.add_connection("/scan", LASER_SCAN, typestore=STORE)
        writer.write(writer.add_connection("/odom", ODOMETRY, typestore=STORE), 10**9, odometry)
    source = BagReader(tmp_path / "bag")
    with pytest.raises(RecordingError, match=r"/scan \(sensor_msgs/msg/LaserScan, but without a message\)"):
        source.check_scans()


def test_topics_are_named_if_none_has_scans(tmp_path: Path, write_bag: WriteBag) -> None:
    odometry = RosEncoder().odometry(Odometry(1.0, np.zeros(3)))
    path = write_bag(tmp_path / "bag", [("/odom", ODOMETRY, 10**9, odometry)])
    reason = r"contains no readable sensor_msgs/msg/LaserScan; its topics are /odom \(nav_msgs/msg/Odometry\)"
    (warning,) = (text for text in drivers.inspect(drivers.open(path)).warnings if "topics" in text)
    assert re.fullmatch(reason, warning)
    result = CliRunner().invoke(app, ["run", str(path), "--out", str(tmp_path / "out")])
    assert result.exit_code == EXIT_USER_ERROR
    assert re.search(reason, result.output)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V2.0\n", b"#ROSBAG V2.0\n" + b"\xff" * 5000, b"\x00" * 5000])
@pytest.mark.parametrize("name", ["a.bag", "a.db3"])
def test_damaged_bags_are_errors(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        list(BagReader(path))
    assert "\n" not in str(caught.value)
    assert len(BagReader(path)) == 0


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.99])
@pytest.mark.parametrize("kind", ["ros1-bag", "ros2-sqlite3", "ros2-mcap"])
def test_truncated_bags_raise_only_recording_errors(
    tmp_path: Path, recordings: dict[str, str], kind: str, share: float
) -> None:
    whole = Path(recordings[kind])
    files = [whole] if whole.is_file() else sorted(whole.iterdir())
    folder = tmp_path / "bag"
    folder.mkdir()
    for file in files:
        content = file.read_bytes()
        cut = content if file.suffix == ".yaml" else content[: int(len(content) * share)]
        (folder / file.name).write_bytes(cut)
    source = drivers.open(folder if whole.is_dir() else folder / whole.name)
    try:
        list(source)
    except RecordingError as error:
        text = str(error)
    else:
        text = ""
    assert "\n" not in text


@settings(max_examples=300, deadline=None)
@given(data=st.data(), kind=st.sampled_from([LASER_SCAN, ODOMETRY, TRANSFORMS]))
def test_damaged_messages_raise_only_value_errors(data: st.DataObject, kind: str) -> None:
    whole = {
        LASER_SCAN: laser_scan(1, [1.0, 2.0, 3.0])[3],
        ODOMETRY: RosEncoder().odometry(Odometry(1.0, np.zeros(3))),
        TRANSFORMS: transform("base_link", "laser", (0, 0, 0), UPRIGHT)[3],
    }
    content = bytearray(whole[kind])
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + 4] = data.draw(st.binary(min_size=4, max_size=4))
    tree = TransformTree()
    try:
        message = decode(bytes(content), kind, "cdr")
        if kind == LASER_SCAN:
            assert np.all(np.diff(scan_of(message, 1, LidarMount()).angles) > 0)
        elif kind == ODOMETRY:
            assert np.all(np.isfinite(planar_pose(message.pose.pose)))
        else:
            tree.add(message)
            tree.find_mount("laser", "base_link")
    except ValueError:
        return


@pytest.mark.parametrize("data", [None, 10**15, 1.5, "text"])
def test_a_message_without_data_is_skipped(tmp_path: Path, write_bag: WriteBag, data: object) -> None:
    bag = write_bag(tmp_path / "sqlite3", [laser_scan(k * 10**9, [1.0, 2.0]) for k in range(3)])
    (file,) = bag.glob("*.db3")
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("ALTER TABLE messages RENAME TO valid")
        database.execute("CREATE TABLE messages AS SELECT * FROM valid")  # without its constraints
        database.execute("UPDATE messages SET data = ? WHERE id = 2", (data,))
    source = drivers.open(bag)
    assert len(list(source)) == 2
    assert source.report.reasons == {"message has no data": 1}


@pytest.mark.parametrize("name", ["3", "null", "[a]", "true"])
def test_metadata_whose_topic_is_no_text_is_refused(write_bag: WriteBag, tmp_path: Path, name: str) -> None:
    bag = write_bag(tmp_path / "bag", [laser_scan(k * 10**8, [1.0] * 5) for k in range(3)])
    metadata = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(metadata.replace("name: /scan", f"name: {name}"))
    with pytest.raises(RecordingError, match="bag: is damaged or not a bag: "):
        list(drivers.open(bag))

"""MCAP files: messages are read back as written, by this project and by ROS tools, even if the writer was killed."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from drivers import GroundTruth, Message, Odometry, RecordingError, Scan, SlamError, YawRate, inspect
from drivers.recordings.mcap import McapReader, McapWriter
from drivers.recordings.ros_encoder import quaternion_of
from drivers.timestamps import to_nanoseconds, to_seconds

Same = Callable[[list[Message], list[Message]], None]


def record(path: Path, messages: list[Message]) -> Path:
    with McapWriter(path) as writer:
        for message in messages:
            writer.write(message)
    return path


def scan(stamp: float, ranges: list[float], angles: list[float], offsets: list[float] | None = None) -> Scan:
    times = np.zeros(len(ranges)) if offsets is None else np.array(offsets)
    return Scan(stamp, np.array(ranges), np.array(angles), times, 0.05, 12.3, None)


def test_simulation_is_read_back_bit_for_bit(tmp_path: Path, drive: list[Message], assert_same: Same) -> None:
    assert_same(list(McapReader(record(tmp_path / "a.mcap", drive))), drive)


def test_uneven_beams_are_read_back_bit_for_bit(tmp_path: Path, assert_same: Same) -> None:
    messages: list[Message] = [
        scan(1.0, [1.234567890123, np.nan, 3.3], [-0.1, 0.2, 0.21], [0.0, 0.033, 0.05]),
        scan(1.1, [0.1, 0.2], [0.0, 1 / 3]),
        scan(1.2, [7.7], [0.123456789]),
        scan(1.2, [7.7, np.nan], [0.0, 1.0]),
        replace(scan(1.3, [7.7, np.nan, 1.0], [0.0, 0.3, 1.0]), intensities=np.array([47.0, 0.0, 12.0])),
        replace(scan(1.4, [7.7, 2.0, 1.0], [0.0, 0.5, 1.0]), intensities=np.array([255.0, 0.0, 65535.0])),
    ]
    reader = McapReader(record(tmp_path / "a.mcap", messages))
    assert_same(list(reader), messages)
    assert inspect(reader).intensities == (0.0, 65535.0)  # of beams with a return


def test_each_mount_is_read_back(tmp_path: Path, assert_same: Same) -> None:
    mounts = [np.array([0.1, 0.2, -3.0]), None, np.array([-0.1, 0.0, 1e-9])]
    messages: list[Message] = []
    for i in range(9):
        normalize_frame = scan(float(i), [1.0, 2.0], [0.0, 1.0])
        ends = (normalize_frame.range_min, normalize_frame.range_max, mounts[i % 3])
        messages.append(
            Scan(
                normalize_frame.stamp,
                normalize_frame.ranges,
                normalize_frame.angles,
                normalize_frame.time_offsets,
                *ends,
            )
        )
    messages.append(Odometry(9.0, np.zeros(3)))
    assert_same(list(McapReader(record(tmp_path / "a.mcap", messages))), messages)


@settings(max_examples=1000)
@given(st.floats(-math.pi, math.pi, exclude_max=True))
def test_quaternions_decode_to_exactly_the_heading(heading: float) -> None:
    z, w = quaternion_of(heading)
    assert 2 * math.atan2(z, w) == pytest.approx(heading, rel=0, abs=1e-300 if abs(heading) < 1e-300 else 0)
    assert math.hypot(z, w) == pytest.approx(1.0, abs=1e-12)


@given(st.integers(0, 2**31 * 10**9))
def test_nanoseconds_are_converted_to_seconds_without_loss(nanoseconds: int) -> None:
    stamp = to_seconds(nanoseconds)
    assert to_seconds(to_nanoseconds(stamp)) == stamp


# Half of a heading around 1e-308 has fewer bits than the heading.
HEADINGS = st.floats(-3.14, 3.14).filter(lambda heading: heading == 0.0 or abs(heading) > 1e-300)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 2, HEADINGS), min_size=1, max_size=20))
@example([(0.0, 0.0, 0.24331333141653375)])
def test_any_poses_are_read_back_bit_for_bit(tmp_path: Path, assert_same: Same, poses: list[tuple[float, ...]]) -> None:
    file = tmp_path / "poses.mcap"
    file.unlink(missing_ok=True)
    messages: list[Message] = []
    for i, pose in enumerate(poses):
        messages += [
            GroundTruth(to_seconds(i * 12345678), np.array(pose)),
            Odometry(to_seconds(i * 12345678), np.array(pose)),
        ]
    decoded = [message for _, message in McapReader(record(file, messages))._read()]  # before jumps are left out
    assert_same(decoded, messages)


def test_ros_tools_read_the_recording(tmp_path: Path, drive: list[Message]) -> None:
    path = record(tmp_path / "a.mcap", drive)
    with AnyReader([path]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        assert kinds == {
            "/odom": "nav_msgs/msg/Odometry",
            "/tf": "tf2_msgs/msg/TFMessage",
            "/scan": "sensor_msgs/msg/LaserScan",
            "/tf_static": "tf2_msgs/msg/TFMessage",
            "/ground_truth": "geometry_msgs/msg/PoseStamped",
        }
        first = next(message for message in drive if isinstance(message, Scan))
        for connection, _, data in reader.messages():
            if connection.topic == "/scan":
                laser_scan = reader.deserialize(data, connection.msgtype)
                assert np.array_equal(laser_scan.ranges, first.ranges.astype(np.float32), equal_nan=True)  # type: ignore[attr-defined]
                assert laser_scan.header.frame_id == "laser"  # type: ignore[attr-defined]
                break


def test_it_is_named_why_no_scan_can_be_read(tmp_path: Path) -> None:
    messages = [scan(1.0, [2.0, 2.0], [1.0, 0.0]), Odometry(1.0, np.zeros(3))]
    with pytest.raises(RecordingError, match=r"contains no readable .*mcap:.*: exact beams are not in order\)$"):
        McapReader(record(tmp_path / "a.mcap", messages)).check_scans()


def test_existing_files_are_overwritten_only_on_request(tmp_path: Path, drive: list[Message]) -> None:
    path = record(tmp_path / "a.mcap", drive)
    with pytest.raises(RecordingError, match="exists already"):
        McapWriter(path)
    McapWriter(path, overwrite=True).close()
    with pytest.raises(RecordingError, match="contains no readable"):
        list(McapReader(path))
    with pytest.raises(RecordingError, match="cannot be written"):
        McapWriter(tmp_path / "no" / "folder.mcap")


def test_stamps_that_cannot_be_recorded_are_refused(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "a.mcap") as writer:
        for stamp in (-1.0, math.nan, math.inf, 3e9, 1e12):
            with pytest.raises(RecordingError, match="stamp"):
                writer.write(Odometry(stamp, np.zeros(3)))


def test_messages_with_lists_are_written_like_those_with_arrays(tmp_path: Path, assert_same: Same) -> None:
    messages: list[Message] = [scan(1.0, [1.5, math.nan], [0.0, 0.25]), Odometry(1.5, np.array([1.0, 2.0, 0.5]))]
    with McapWriter(tmp_path / "a.mcap") as writer:
        writer.write(Scan(1.0, [1.5, math.nan], [0.0, 0.25], [0, 0], 0.05, 12.3))  # type: ignore[arg-type]
        writer.write(Odometry(1.5, (1, 2, 0.5)))  # type: ignore[arg-type]
    assert_same(list(McapReader(tmp_path / "a.mcap")), messages)


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (scan(1.0, [1.5, 2.0], [0.0]), "scan at 1.000 s: 2 ranges, 1 angles and 2 time offsets"),
        (Odometry(1.0, np.zeros(2)), "odometry at 1.000 s: pose must be 3 numbers"),
        (Odometry("now", np.zeros(3)), "odometry: the stamp must be a number of seconds, not 'now'"),  # type: ignore[arg-type]
        (YawRate(1.0, "left"), "yaw rate at 1.000 s: the rate must be a number"),  # type: ignore[arg-type]
        ("hello", "a message must be a Scan, .* not of type str"),
    ],
)
def test_messages_that_cannot_be_written_are_refused_in_one_line(tmp_path: Path, message: Any, problem: str) -> None:
    with McapWriter(tmp_path / "a.mcap") as writer, pytest.raises(SlamError, match=problem) as raised:
        writer.write(message)
    assert "\n" not in str(raised.value)


ENDLESS_WRITER = """
import sys, time
import numpy as np
from drivers import Odometry
from drivers.recordings.mcap import McapWriter
with McapWriter(sys.argv[1]) as writer:
    while True:
        writer.write(Odometry(time.time_ns() / 10**9, np.zeros(3)))
        print(time.time(), flush=True)
        time.sleep(0.01)
"""


def test_killed_process_loses_at_most_a_second(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    process = subprocess.Popen([sys.executable, "-c", ENDLESS_WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    first = float(process.stdout.readline())
    last = first
    while last < first + 2.5:
        last = float(process.stdout.readline())
    os.kill(process.pid, signal.SIGKILL)
    last = max([last, *(float(line) for line in process.stdout.read().split())])
    process.wait()
    process.stdout.close()
    source = McapReader(path)
    messages = list(source)
    assert messages[-1].stamp > last - 1.2
    assert source.report.skipped == 1
    assert "is truncated" in str(source.report.first)
    assert len(source) == 0


def test_truncated_file_is_read_up_to_the_last_complete_chunk(
    tmp_path: Path, drive: list[Message], assert_same: Same
) -> None:
    path = record(tmp_path / "a.mcap", drive + [Odometry(4 + i / 100, np.zeros(3)) for i in range(4000)])
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    source = McapReader(path)
    messages = list(source)
    assert_same(messages[: len(drive)], drive)
    assert len(messages) < len(drive) + 4000
    assert source.report.skipped == 1


@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP", b"\x00" * 100, b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\xff" * 50]
)
def test_other_files_are_errors(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        list(McapReader(path))
    assert "\n" not in str(caught.value)
    assert len(McapReader(path)) == 0


@pytest.fixture(scope="module")
def short_file(tmp_path_factory: pytest.TempPathFactory, drive: list[Message]) -> bytes:
    return record(tmp_path_factory.mktemp("mcap") / "short.mcap", drive[:12]).read_bytes()


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files_raise_only_recording_errors(tmp_path: Path, short_file: bytes, data: st.DataObject) -> None:
    content = bytearray(short_file)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + data.draw(st.integers(0, 8))] = data.draw(st.binary(max_size=8))
    content = content[: data.draw(st.integers(1, len(content)))]
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    source = McapReader(path)
    assert len(source) >= 0
    start = time.process_time()  # other programs do not count
    try:
        messages = list(source)
    except RecordingError:
        return
    finally:
        assert time.process_time() - start < 10
    stamps = [message.stamp for message in messages]
    assert stamps == sorted(stamps)


@pytest.fixture
def chunks(tmp_path: Path, drive: list[Message], monkeypatch: pytest.MonkeyPatch) -> tuple[Path, float]:
    """Return a recording with a chunk for each message, and the bytes of memory that its writer keeps of each."""
    monkeypatch.setattr("drivers.recordings.mcap.FLUSH_PERIOD", 0.0)
    monkeypatch.setattr("drivers.recordings.mcap.os.fsync", lambda file: None)
    half = len(drive) // 2
    tracemalloc.start()
    try:
        with McapWriter(tmp_path / "chunks.mcap") as writer:
            for message in drive[:half]:
                writer.write(message)
            before = tracemalloc.get_traced_memory()[0]
            for message in drive[half:]:
                writer.write(message)
            kept = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    return tmp_path / "chunks.mcap", kept / (len(drive) - half)


def test_memory_for_a_chunk_is_that_of_its_index_in_the_file(chunks: tuple[Path, float]) -> None:
    """A chunk is finished twice a second, for days."""
    with chunks[0].open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    builder = RecordBuilder()
    for index in summary.chunk_indexes:
        index.write(builder)
    assert chunks[1] < 1.5 * builder.count / len(summary.chunk_indexes)


def test_messages_of_any_time_are_found_by_the_index(chunks: tuple[Path, float], drive: list[Message]) -> None:
    stamps = sorted({to_nanoseconds(message.stamp) for message in drive if isinstance(message, Scan)})
    middle = len(stamps) // 2
    with chunks[0].open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        found = list(reader.iter_messages(["/scan"], starting_at=stamps[middle], ending_before=stamps[middle + 3]))
    assert summary is not None
    assert len(summary.chunk_indexes) == len(drive)
    assert [message.log_time for _, _, message in found] == stamps[middle : middle + 3]

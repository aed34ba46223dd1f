"""CARMEN logs: all supported lines, and the defects of real logs."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers import Message, Odometry, RecordingError, Scan
from drivers.recordings.carmen import CarmenReader
from drivers.recordings.carmen_lines import half_turn_angles


def read(folder: Path, text: str | bytes) -> tuple[list[Message], CarmenReader]:
    path = folder / "log.clf"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    source = CarmenReader(path)
    return list(source), source


def odom(stamp: float, x: float = 0.0) -> str:
    return f"ODOM {x} 0 0 0 0 0 {stamp:.6f} host 0.0\n"


def flaser(stamp: float, ranges: str = "1.0 2.0 3.0", pose: str = "0 0 0", laser: str = "0 0 0") -> str:
    return f"FLASER {len(ranges.split())} {ranges} {laser} {pose} {stamp:.6f} host 0.0\n"


@pytest.mark.parametrize(
    ("count", "first", "last", "step"),
    [(180, -90, 89, 1), (181, -90, 90, 1), (360, -90, 89.5, 0.5), (361, -90, 90, 0.5), (5, -90, 90, 45)],
)
def test_angles_that_the_line_does_not_state(count: int, first: float, last: float, step: float) -> None:
    angles = np.degrees(half_turn_angles(count))
    assert len(angles) == count
    assert angles[[0, -1]] == pytest.approx([first, last])
    assert np.diff(angles) == pytest.approx(step)


def test_odom_and_flaser_lines_are_read(tmp_path: Path) -> None:
    messages, _ = read(tmp_path, odom(1.0, x=0.5) + flaser(2.0, "1.5 81.91 2.5", pose="0.7 0 0", laser="0.7 0 0"))
    first, repeated, scan = messages
    assert isinstance(first, Odometry)
    assert first.pose.tolist() == [0.5, 0, 0]
    assert isinstance(repeated, Odometry)
    assert (repeated.stamp, repeated.pose.tolist()) == (2.0, [0.7, 0, 0])
    assert isinstance(scan, Scan)
    assert scan.ranges == pytest.approx([1.5, np.nan, 2.5], nan_ok=True)
    assert scan.range_max == 81.83


def test_repeated_odometry_is_yielded_once(tmp_path: Path) -> None:
    text = odom(1.0, x=0.5) + flaser(1.0, pose="0.5 0 0") + flaser(2.0, pose="0.6 0 0") + odom(2.0, x=0.6)
    messages, _ = read(tmp_path, text)
    assert [type(message).__name__ for message in messages] == ["Odometry", "Scan", "Odometry", "Scan"]


def test_robotlaser_line_is_read(tmp_path: Path) -> None:
    line = (
        "ROBOTLASER1 0 -1.0 2.0 0.5 20.0 0.01 0 5 1.0 2.0 20.0 25.0 3.0 2 100 200 "
        "1.2 0 0 1.0 0 0 0.1 0.2 0.3 0.4 0.5 12.5 host 0.0\n"
    )
    messages, _ = read(tmp_path, line)
    scan = messages[-1]
    assert isinstance(scan, Scan)
    assert scan.angles == pytest.approx([-1, -0.5, 0, 0.5, 1])
    assert scan.ranges == pytest.approx([1, 2, np.nan, np.nan, 3], nan_ok=True)
    assert scan.range_max == 20.0
    assert scan.stamp == 12.5
    assert scan.mount == pytest.approx([0.2, 0, 0])
    assert isinstance(messages[0], Odometry)


def test_rear_laser_has_its_own_mount(tmp_path: Path) -> None:
    front = flaser(1.0, pose="1 0 0", laser="1.1 0 0")
    rear = flaser(1.0, pose="1 0 0", laser="0.8 0 3.141593").replace("FLASER", "RLASER")
    scans = [message for message in read(tmp_path, front + rear)[0] if isinstance(message, Scan)]
    mounts = [scan.mount for scan in scans if scan.mount is not None]
    assert mounts[0] == pytest.approx([0.1, 0, 0])
    assert mounts[1][:2] == pytest.approx([-0.2, 0])
    assert abs(mounts[1][2]) == pytest.approx(np.pi)


def test_mount_is_constant_despite_rounding(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    lines = []
    for i in range(50):
        x, y, heading = random.uniform(-100, 100), random.uniform(-100, 100), random.uniform(-3, 3)
        lx, ly = x - 0.04 * np.cos(heading), y - 0.04 * np.sin(heading)
        pose, laser = f"{x:.6f} {y:.6f} {heading:.6f}", f"{lx:.6f} {ly:.6f} {heading:.6f}"
        lines.append(flaser(1.0 + i, pose=pose, laser=laser))
    scans = [message for message in read(tmp_path, "".join(lines))[0] if isinstance(message, Scan)]
    assert all(scan.mount is not None and scan.mount.tolist() == [-0.04, 0.0, 0.0] for scan in scans)


def test_mount_is_unknown_if_laser_and_robot_poses_are_not_rigidly_connected(tmp_path: Path) -> None:
    text = "".join(flaser(i, pose=f"{i} 0 0", laser=f"{i * i} 0 0") for i in range(1, 20))
    scan = read(tmp_path, text)[0][-1]
    assert isinstance(scan, Scan)
    assert scan.mount is None


def test_log_without_a_robot_has_no_odometry(tmp_path: Path) -> None:
    messages, _ = read(tmp_path, flaser(1.0) + flaser(2.0))
    assert [type(message) for message in messages] == [Scan, Scan]


def test_files_of_windows_are_read(tmp_path: Path) -> None:
    """With a mark of their encoding, and empty lines."""
    text = (odom(1.0) + flaser(1.0)).replace("\n", "\r\n\r\n")
    messages, source = read(tmp_path, b"\xef\xbb\xbf" + text.encode())
    assert [type(message) for message in messages] == [Odometry, Scan]
    assert source.report.skipped == 0


def test_a_robot_that_stands_at_the_origin_at_first_has_odometry(tmp_path: Path) -> None:
    messages, _ = read(tmp_path, flaser(1.0) + flaser(2.0) + flaser(3.0, pose="0.1 0 0"))
    assert [type(message) for message in messages] == [Odometry, Scan] * 3


def test_no_return_value_of_an_unknown_laser_is_determined(tmp_path: Path) -> None:
    text = "".join(flaser(i, f"1.{i:02d} 29.99 29.99 2.0") for i in range(1, 30))
    scan = read(tmp_path, text)[0][-1]
    assert isinstance(scan, Scan)
    assert np.isnan(scan.ranges).tolist() == [False, True, True, False]
    assert scan.range_max == 29.99


def test_no_return_value_below_the_stated_limit_is_determined(tmp_path: Path) -> None:
    text = "".join(
        f"ROBOTLASER1 0 -1.0 2.0 0.5 80.0 0.01 0 5 1.{i:02d} 51.1 51.09 2.0 90.0 0 0 0 0 0 0 0 0 0 0 0 0 {i} host 0\n"
        for i in range(1, 30)
    )
    scan = read(tmp_path, text)[0][-1]
    assert isinstance(scan, Scan)
    assert np.isnan(scan.ranges).tolist() == [False, True, True, False, True]
    assert scan.range_max == 51.09


def test_invalid_readings_become_nan(tmp_path: Path) -> None:
    scan = read(tmp_path, flaser(1.0, "1.0 nan inf -inf -1.0 0.0 1e300"))[0][-1]
    assert isinstance(scan, Scan)
    assert np.isnan(scan.ranges).tolist() == [False] + [True] * 6


def test_number_of_beams_may_vary(tmp_path: Path) -> None:
    scans = read(tmp_path, flaser(1.0, "1 2 3") + flaser(2.0, "1 2 3 4"))[0]
    assert [len(scan.angles) for scan in scans if isinstance(scan, Scan)] == [3, 4]


BAD_LINES = {
    "cut off": "FLASER 3 1.0 2.0",
    "cut in the stamp": "ODOM 0 0 0 0 0 0 97605",
    "wrong number of beams": flaser(5.0).replace("FLASER 3", "FLASER 5"),
    "no beams": "FLASER 0 0 0 0 0 0 0 5.0 host 0.0",
    "negative number of beams": "FLASER -3 0 0 0 0 0 0 5.0 host 0.0",
    "not a number": flaser(5.0).replace("2.0", "two"),
    "stamp is not finite": "ODOM 0 0 0 0 0 0 nan host 0.0",
    "stamp is negative": "ODOM 0 0 0 0 0 0 -5 host 0.0",
    "pose is not finite": "ODOM inf 0 0 0 0 0 5 host 0.0",
    "robotlaser without remissions": "ROBOTLASER1 0 -1 2 0.5 20 0.01 0 2 1.0 2.0",
    "robotlaser with impossible angles": "ROBOTLASER1 0 nan 2 0.5 20 0.01 0 1 1.0 0 0 0 0 0 0 0 0 0 0 0 0 5 host 0",
    "binary": "\x00\x01\x02\x80\x90",
    "binary behind a name": "FLASER \x00\x01\x02\x80\x90",
}


@pytest.mark.parametrize("line", BAD_LINES.values(), ids=BAD_LINES.keys())
def test_bad_line_is_counted_and_located(tmp_path: Path, line: str) -> None:
    messages, source = read(tmp_path, odom(1.0) + line.rstrip("\n") + "\n" + odom(2.0))
    assert [message.stamp for message in messages] == [1.0, 2.0]
    assert source.report.skipped == 1
    assert sum(source.report.reasons.values()) == 1
    assert source.report.first is not None
    assert source.report.first.startswith(f"{source.path}:2: ")
    assert "\n" not in source.report.first


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is empty"),
        (b" \n\n", "is empty"),
        (b"\x00\xff\x80" * 1000, "not a CARMEN log"),
        (b"some text\nabout nothing\n", "not a CARMEN log"),
        (b"FLASER 3 1 2\n", "not a CARMEN log"),
        (b"1361431443 14554 0 0 559 557\n", "line: does not begin with the name of a message"),
        (b"\x1f\x8b\x08garbage", "gzip"),
        (b"BZhgarbage", "bzip2"),
        (gzip.compress(b"", mtime=0), "is empty"),
    ],
)
def test_log_without_a_valid_line_is_an_error(tmp_path: Path, content: bytes, reason: str) -> None:
    with pytest.raises(RecordingError, match=reason) as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize(
    ("compression", "compress"), [("gzip", gzip.compress), ("bzip2", partial(bz2.compress, compresslevel=1))]
)
def test_a_truncated_compressed_log_is_read_up_to_the_truncation(
    tmp_path: Path, compression: str, compress: Callable[[bytes], bytes]
) -> None:
    lines = "".join(odom(1.0 + i, x=np.sin(i)) for i in range(8000))  # some blocks
    compressed = compress(lines.encode())
    messages, source = read(tmp_path, compressed[: len(compressed) * 3 // 4])
    assert 100 < len(messages) < 8000
    assert any(compression in reason for reason in source.report.reasons)


def test_errors_of_the_disk_are_not_those_of_the_compression(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> bytes:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(gzip.GzipFile, "read", fail)
    with pytest.raises(RecordingError, match="cannot be read: Input/output error"):
        read(tmp_path, gzip.compress(odom(1.0).encode()))


def test_missing_files_and_directories_are_errors(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        CarmenReader(tmp_path / "nothing.clf")
    with pytest.raises(RecordingError, match="cannot be read: Is a directory"):
        list(CarmenReader(tmp_path))
    assert len(CarmenReader(tmp_path)) == 0


def test_file_without_read_permission_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.clf").write_text(odom(1.0))

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(RecordingError, match="cannot be read: Permission denied"):
        list(CarmenReader(tmp_path / "log.clf"))


LINES = odom(1.0) + flaser(1.1, "1.0 2.0 3.0 4.0") + odom(1.2) + flaser(1.3, "1.0 2.0 3.0 4.0")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damaged_logs_raise_only_recording_errors(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(LINES.encode())
    for _ in range(data.draw(st.integers(1, 8))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + data.draw(st.integers(0, 5))] = data.draw(st.binary(max_size=6))
        content = content or bytearray(b"x")
    try:
        messages, source = read(tmp_path, bytes(content))
    except RecordingError:
        return
    stamps = [message.stamp for message in messages]
    assert stamps == sorted(stamps)
    assert source.report.messages == len(messages)


def test_numbers_are_the_same_however_many_are_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    texts = [f"{value:.4f}" for value in np.random.default_rng(1).uniform(0.1, 30.0, 60)]
    log = "".join(flaser(0.1 * k, " ".join(texts[k : k + 30])) for k in range(30))
    for remembered in (1 << 16, 7):
        monkeypatch.setattr("drivers.recordings.carmen_lines.MAX_NUMBERS", remembered)
        messages, _ = read(tmp_path, log)
        scans = [message for message in messages if isinstance(message, Scan)]
        for k, scan in enumerate(scans):
            np.testing.assert_array_equal(scan.ranges, [float(text) for text in texts[k : k + 30]])
        assert len(scans) == 30

"""Scans with several echoes per beam: the first echo is read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import Scan
from drivers.recordings.multi_echo import MULTI_ECHO, first_echoes
from drivers.recordings.ros_messages import LASER_SCAN, decode, type_store
from drivers.recordings.rosbag import BagReader
from drivers.recordings.stored_messages import StoredMessage

Stored = tuple[str, str, int, bytes]
WriteBag = Callable[[Path, list[Stored]], Path]
TYPES: dict[str, Any] = dict(type_store("cdr").types)
BEAMS = [[2.0, 5.0], [], [3.0], [1.5, 2.5, 4.0]]
"""Echoes of four beams, metres."""


def multi_echo(beams: list[list[float]], frame: str = "laser", second: int = 1) -> bytes:
    """Return a MultiEchoLaserScan in CDR with echoes and equal intensities."""
    echoes = [TYPES["sensor_msgs/msg/LaserEcho"](np.array(beam, dtype=np.float32)) for beam in beams]
    header = TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](second, 0), frame)
    message = TYPES[MULTI_ECHO](header, -1.0, 0.5, 0.5, 0.001, 0.1, 0.1, 10.0, echoes, echoes)
    return bytes(type_store("cdr").serialize_cdr(message, MULTI_ECHO))


@pytest.mark.parametrize("frame", ["", "laser", "base", "horizontal_laser_link"])
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_scans_have_the_first_echo_of_each_beam(encoding: str, frame: str) -> None:
    data = multi_echo(BEAMS, frame)
    if encoding == "ros1":
        data = bytes(type_store("cdr").cdr_to_ros1(data, MULTI_ECHO))
    stored = first_echoes(StoredMessage(1, "/echoes", MULTI_ECHO, encoding, 7, data))
    scan = decode(stored.data, LASER_SCAN, encoding)
    assert (stored.msgtype, stored.topic, stored.received) == (LASER_SCAN, "/echoes", 7)
    np.testing.assert_array_equal(scan.ranges, np.array([2.0, np.nan, 3.0, 1.5], dtype=np.float32))
    np.testing.assert_array_equal(scan.intensities, scan.ranges)
    assert (scan.header.frame_id, scan.range_max) == (frame, 10.0)


def test_messages_that_are_cut_short_cannot_be_decoded() -> None:
    data = multi_echo(BEAMS)
    for length in range(len(data)):
        stored = first_echoes(StoredMessage(1, "/echoes", MULTI_ECHO, "cdr", 7, data[:length]))
        with pytest.raises(ValueError, match="cannot be decoded"):
            decode(stored.data, LASER_SCAN, "cdr")


@pytest.mark.parametrize("name", ["drive.bag", "drive"])
def test_a_bag_of_a_lidar_with_several_echoes_is_read(tmp_path: Path, write_bag: WriteBag, name: str) -> None:
    beams = [[[4.0 + 0.5 * k, 7.0], [], [3.0]] for k in range(4)]
    entries = [("/echoes", MULTI_ECHO, k, multi_echo(beams[k], second=k)) for k in range(1, 4)]
    source = BagReader(write_bag(tmp_path / name, entries))
    scans = [message for message in source if isinstance(message, Scan)]
    assert [scan.stamp for scan in scans] == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(scans[0].ranges, [4.5, np.nan, 3.0])
    assert source.report.skipped == 0


def test_scans_with_one_echo_are_preferred(tmp_path: Path, write_bag: WriteBag) -> None:
    scan = first_echoes(StoredMessage(1, "/first", MULTI_ECHO, "cdr", 1, multi_echo([[4.0]] * 4)))
    entries = [("/echoes", MULTI_ECHO, k, multi_echo(BEAMS, second=k + 1)) for k in range(3)]
    bag = write_bag(tmp_path / "drive", [*entries, ("/first", LASER_SCAN, 4, scan.data)])
    (default,) = (message for message in BagReader(bag) if isinstance(message, Scan))
    np.testing.assert_array_equal(default.ranges, [4.0] * 4)
    named = [message for message in BagReader(bag, scan_topic="/echoes") if isinstance(message, Scan)]
    assert len(named) == 3

"""ROS 1 bags without a valid index: of recorders that were killed, cut short, or damaged."""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer

import drivers
from drivers import Message, RecordingError
from drivers.recordings.ros_messages import type_store
from drivers.recordings.rosbag import BagReader
from drivers.recordings.unindexed_bag import read_unindexed

INDEX = b"index_pos="
TYPES = frozenset({"sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"})


def with_index_at(content: bytes, position: int) -> bytes:
    """Return a bag whose header states another position of the index, as 0 until the recorder closes it."""
    at = content.index(INDEX) + len(INDEX)
    return content[:at] + struct.pack("<Q", position) + content[at + 8 :]


@pytest.fixture
def bag(recordings: dict[str, str]) -> bytes:
    return Path(recordings["ros1-bag"]).read_bytes()


def compressed(path: Path, original: str, compression: Any) -> Path:
    """Write the messages of a bag into a compressed one."""
    writer = Writer(path)
    writer.set_compression(compression)
    with writer:
        connections: dict[str, Any] = {}
        for topic, msgtype, received, data in read_unindexed(Path(original), TYPES):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=type_store("ros1"))
            writer.write(connections[topic], received, data)
    return path


def same(one: list[Message], other: list[Message]) -> bool:
    return [(type(message), message.stamp) for message in one] == [(type(message), message.stamp) for message in other]


@pytest.mark.parametrize("name", ["drive.bag", "drive.bag.active"])
def test_a_bag_that_was_not_closed_is_read(tmp_path: Path, recordings: dict[str, str], bag: bytes, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(with_index_at(bag, 0))
    source = drivers.open(path)
    messages = list(source)
    assert same(messages, list(drivers.open(recordings["ros1-bag"])))
    assert source.report.interpretations == [
        "records in the order of the file, since the index of the bag is missing or damaged"
    ]


def with_long_indices(content: bytes) -> bytes:
    """Return a bag whose records with the places of a chunk's messages state 20 bytes for each, and have 12."""
    changed, at = bytearray(content), len(b"#ROSBAG V2.0\n")
    while at < len(content):
        (header,) = struct.unpack_from("<I", content, at)
        at += 4 + header
        (length,) = struct.unpack_from("<I", content, at)
        if b"op=\x04" in content[at - header : at]:
            struct.pack_into("<I", changed, at, length // 12 * 20)
        at += 4 + length
    return bytes(changed)


def test_a_bag_of_the_first_recorders_of_its_version_is_read(
    tmp_path: Path, recordings: dict[str, str], bag: bytes
) -> None:
    (path := tmp_path / "drive.bag").write_bytes(with_long_indices(bag))
    assert path.read_bytes() != bag
    source = drivers.open(path)
    assert same(list(source), list(drivers.open(recordings["ros1-bag"])))
    assert not source.report.skipped


@pytest.mark.parametrize("compression", [Writer.CompressionFormat.LZ4, Writer.CompressionFormat.BZ2])
def test_compressed_chunks_are_read(tmp_path: Path, recordings: dict[str, str], compression: Any) -> None:
    path = compressed(tmp_path / "drive.bag", recordings["ros1-bag"], compression)
    whole = list(drivers.open(path))
    path.write_bytes(with_index_at(path.read_bytes(), 0))
    assert same(list(drivers.open(path)), whole)


def test_a_bag_that_was_cut_short_is_read_up_to_its_end(tmp_path: Path, recordings: dict[str, str], bag: bytes) -> None:
    path = tmp_path / "drive.bag"
    path.write_bytes(bag[: int(0.6 * len(bag))])
    source = BagReader(path)
    messages = list(source)
    whole = list(drivers.open(recordings["ros1-bag"]))
    assert 0.4 * len(whole) < len(messages) < len(whole)
    assert same(messages, whole[: len(messages)])
    assert source.report.reasons == {"bag is truncated or damaged; it was read up to this point": 1}


def test_a_chunk_whose_length_the_recorder_left_open_is_read(tmp_path: Path, bag: bytes) -> None:
    at = bag.index(b"compression=none")
    size = bag.index(b"size=", at) + 5
    length = struct.unpack_from("<I", bag, size)[0]
    open_chunk = bag[:size] + bytes(8) + bag[size + 8 : size + 8 + length]
    path = tmp_path / "drive.bag.active"
    path.write_bytes(with_index_at(open_chunk, 0))
    assert len(list(drivers.open(path))) > 10


def test_topics_are_named_if_a_bag_without_index_has_no_scans(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag.active"
    with Writer(path) as writer:
        topic = writer.add_connection("/plot", "std_msgs/msg/Float64", typestore=type_store("ros1"))
        writer.write(topic, 0, bytes(8))
    path.write_bytes(with_index_at(path.read_bytes(), 0))
    with pytest.raises(RecordingError, match=r"no readable .*; its topics are /plot \(std_msgs/msg/Float64\)"):
        list(drivers.open(path))


def test_reserved_space_that_was_not_written_ends_the_bag(tmp_path: Path, bag: bytes) -> None:
    path = tmp_path / "drive.bag"
    path.write_bytes(with_index_at(bag[: len(bag) // 2], 0) + bytes(100_000))
    source = BagReader(path)
    assert len(list(source)) > 10
    assert "bag is truncated or damaged; it was read up to this point" in source.report.reasons


def test_bags_of_before_2010_are_named(tmp_path: Path) -> None:
    path = tmp_path / "old.bag"
    path.write_bytes(b"#ROSRECORD V1.2\n" + bytes(100))
    with pytest.raises(RecordingError, match="is a bag of before 2010"):
        list(BagReader(path))


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_damaged_bags_raise_only_value_errors(
    tmp_path_factory: pytest.TempPathFactory, recordings: dict[str, str], data: st.DataObject
) -> None:
    content = bytearray(Path(recordings["ros1-bag"]).read_bytes())
    for _ in range(data.draw(st.integers(1, 8))):
        at = data.draw(st.integers(13, len(content) - 1))
        content[at : at + 4] = data.draw(st.binary(min_size=4, max_size=4))
    path = tmp_path_factory.mktemp("damaged") / "drive.bag"
    path.write_bytes(content)
    with suppress(ValueError):
        for _, msgtype, received, _ in read_unindexed(path, TYPES):
            assert msgtype in TYPES
            assert received >= 0

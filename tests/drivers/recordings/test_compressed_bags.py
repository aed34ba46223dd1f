"""ROS 2 bags that the recorder has compressed, and files of bags that are named instead of the bag's directory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

import drivers
from drivers import Message, RecordingError, Scan
from drivers.recordings.decompression import uncompressed_message
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import LASER_SCAN, type_store

PLUGINS = {"db3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}


@pytest.fixture
def write_compressed(tmp_path: Path, drive: list[Message]) -> Callable[..., Path]:
    """Function that writes a bag whose messages are compressed one by one, the second with other data if given."""

    def write(suffix: str, damaged: bytes | None = None) -> Path:
        writer = Writer(tmp_path / "bag", version=9, storage_plugin=PLUGINS[suffix])
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        encoder = RosEncoder()
        with writer:
            connection = writer.add_connection("/scan", LASER_SCAN, typestore=type_store("cdr"))
            for number, scan in enumerate([m for m in drive if isinstance(m, Scan)][:3]):
                data = damaged if damaged is not None and number == 1 else encoder.scan(scan, "laser")
                writer.write(connection, number, data)
        return tmp_path / "bag"

    return write


def scans(path: Path) -> list[Scan]:
    return [message for message in drivers.open(path) if isinstance(message, Scan)]


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
def test_compressed_messages_of_a_file_without_metadata_are_read(
    tmp_path: Path, write_compressed: Callable[..., Path], suffix: str
) -> None:
    """`ros2 bag record --compression-mode message`: that it did is written in the metadata only."""
    bag = write_compressed(suffix)
    (file,) = bag.glob(f"*.{suffix}")
    whole, alone = scans(bag), scans(file.rename(tmp_path / file.name))
    assert len(whole) == 3
    for expected, found in zip(whole, alone, strict=True):
        np.testing.assert_array_equal(found.ranges, expected.ranges)


def test_damaged_messages_are_counted(tmp_path: Path, write_compressed: Callable[..., Path]) -> None:
    bag = write_compressed("mcap", b"no message")
    (file,) = bag.glob("*.mcap")
    source = drivers.open(file)
    assert len([m for m in source if isinstance(m, Scan)]) == 2
    assert source.report.skipped == 1


def test_damaged_compression_is_left_to_the_decoder() -> None:
    damaged = b"\x28\xb5\x2f\xfd" + 50 * b"\xff"
    assert uncompressed_message(damaged) == damaged


def test_the_metadata_stand_for_their_bag(write_compressed: Callable[..., Path]) -> None:
    bag = write_compressed("db3")
    assert [scan.stamp for scan in scans(bag / "metadata.yaml")] == [scan.stamp for scan in scans(bag)]


def test_a_file_that_is_compressed_as_a_whole_is_refused_with_the_remedy(tmp_path: Path) -> None:
    file = tmp_path / "drive_0.db3.zstd"
    file.write_bytes(b"\x28\xb5\x2f\xfd")
    with pytest.raises(RecordingError, match="name the directory of its bag, or `zstd -d` it"):
        drivers.open(file)


def test_a_bag_in_several_files_without_metadata_is_refused_with_the_remedy(tmp_path: Path) -> None:
    for number in range(2):
        (tmp_path / f"drive_{number}.db3").write_bytes(b"SQLite")
    with pytest.raises(RecordingError, match=r"no metadata\.yaml, which `ros2 bag reindex` writes; name one of"):
        drivers.open(tmp_path)

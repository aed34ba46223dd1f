"""Recordings that are small and decompress to gigabytes are refused, in little memory."""

from __future__ import annotations

import bz2
import gzip
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from drivers import Odometry
from drivers.recordings import decompression
from drivers.recordings.decompression import DecompressionError, allowed_size, decompress
from drivers.recordings.mcap import MAGIC, McapWriter

MEBIBYTE = 1 << 20
COMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.compress,
    "lz4": lz4.frame.compress,
    "bz2": bz2.compress,
}
READ = """
import resource, sys
import drivers
from drivers.errors import RecordingError

before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    list(drivers.open(sys.argv[1]))
except RecordingError as error:
    print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


def read(path: Path) -> tuple[str, int]:
    """Return the error of reading a recording in a process of its own, and the memory that it used, MiB."""
    lines = subprocess.run([sys.executable, "-c", READ, path], capture_output=True, text=True, check=True).stdout
    (error, memory) = lines.splitlines()
    return error, int(memory)


@pytest.mark.parametrize("compression", COMPRESS)
def test_chunks_are_decompressed_up_to_the_limit(compression: str) -> None:
    content = np.random.default_rng(1).integers(0, 9, MEBIBYTE, np.uint8).tobytes()
    compressed = COMPRESS[compression](content)
    assert decompress(compressed, compression, MEBIBYTE) == content
    with pytest.raises(DecompressionError, match="decompresses to more than 1 MB"):
        decompress(compressed, compression, MEBIBYTE - 1)


def test_a_chunk_of_an_mcap_file_that_decompresses_to_gigabytes_is_refused(tmp_path: Path) -> None:
    compressor = zstandard.ZstdCompressor().compressobj()
    data = b"".join(compressor.compress(bytes(16 * MEBIBYTE)) for _ in range(64)) + compressor.flush()
    assert len(data) < 0.1 * MEBIBYTE
    fields = struct.pack("<QQQII4sQ", 0, 0, 64 * 16 * MEBIBYTE, 0, 4, b"zstd", len(data)) + data
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", Opcode.CHUNK, len(fields)) + fields)
    error, memory = read(path)
    assert "bomb.mcap: a chunk of " in error
    assert "decompresses to more than 134 MB" in error
    assert memory < 500


@pytest.mark.parametrize(
    ("suffix", "compress"), [(".gz", gzip.compress), pytest.param(".bz2", bz2.compress, marks=pytest.mark.slow)]
)
def test_a_log_that_decompresses_to_gigabytes_is_refused(
    tmp_path: Path, suffix: str, compress: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / f"bomb.clf{suffix}"
    path.write_bytes(100 * compress(b"#\n" * (MEBIBYTE // 2)))
    error, memory = read(path)
    assert f"{path.name}: decompresses to more than 50 times its size; to read it anyway, decompress it first" in error
    assert memory < 500


def test_a_chunk_of_a_bag_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    types = get_typestore(Stores.ROS1_NOETIC)
    writer = BagWriter(tmp_path / "bomb.bag")
    writer.set_compression(BagWriter.CompressionFormat.BZ2)
    with writer:
        connection = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=types)
        for stamp in range(1000):
            writer.write(connection, stamp, bytes(1000))
    import drivers

    monkeypatch.setattr("drivers.recordings.rosbag_limits.decompress", lambda *a: decompression.decompress(*a[:2], 10))
    with pytest.raises(drivers.RecordingError, match=r"bomb\.bag: a chunk of \d+ bytes decompresses to more than"):
        list(drivers.open(tmp_path / "bomb.bag"))


def test_ordinary_recordings_are_within_the_limits(tmp_path: Path) -> None:
    import drivers

    with McapWriter(tmp_path / "a.mcap") as writer:
        for k in range(100):
            writer.write(Odometry(1e9 + k, np.zeros(3)))
    assert len(list(drivers.open(tmp_path / "a.mcap"))) == 100
    assert allowed_size(10) == decompression.ALWAYS_ALLOWED
    assert allowed_size(10**8) == 50 * 10**8

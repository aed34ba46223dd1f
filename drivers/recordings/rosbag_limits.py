"""Limits for the library rosbags, which decompresses chunks, messages and files without any."""

from __future__ import annotations

from typing import Any

import rosbags.rosbag1.reader as rosbag1
import rosbags.rosbag2.reader as rosbag2
import rosbags.rosbag2.storage_mcap as storage_mcap

from .decompression import MAX_CHUNK_SIZE, MAX_RATIO, DecompressionError, allowed_size, decompress


def limit_rosbags() -> None:
    """Replace the functions with which rosbags decompresses."""
    rosbag1.decompressors.update({name: _of_chunk(name) for name in ("bz2", "lz4")})
    storage_mcap.DECOMPRESSORS.update({name: _of_sized_chunk(name) for name in ("lz4", "zstd")})
    vars(rosbag2)["zstd"] = _LimitedZstd


def _of_chunk(compression: str) -> Any:
    return lambda data: decompress(data, compression)


def _of_sized_chunk(compression: str) -> Any:
    return lambda data, size: decompress(data, compression, min(size, MAX_CHUNK_SIZE))


class _LimitedZstd:
    """The part of the module zstd that rosbags uses: for single messages, and for whole files."""

    @staticmethod
    def decompress(data: bytes) -> bytes:
        return decompress(data, "zstd")

    @staticmethod
    def open(file: Any, _: str) -> _LimitedFile:
        return _LimitedFile(file)


class _LimitedFile:
    """Reader of a compressed file; a context manager. Raises DecompressionError beyond `allowed_size`."""

    def __init__(self, file: Any) -> None:
        import zstandard

        self._left = allowed_size(file.seek(0, 2))
        file.seek(0)
        self._content: Any = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)

    def __enter__(self) -> _LimitedFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._content.close()

    def read(self, size: int) -> bytes:
        data: bytes = self._content.read(size)
        self._left -= len(data)
        if self._left < 0:
            raise DecompressionError(f"a file of it decompresses to more than {MAX_RATIO} times its size")
        return data

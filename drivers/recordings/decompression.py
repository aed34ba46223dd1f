"""Decompression with limits: a small file must not fill the memory or the disk.

A few kilobytes can decompress to gigabytes. Chunks and messages of recordings have some megabytes at most; whole files
of text become ten times as large. Whoever has a legitimate file beyond the limits can decompress or rewrite it first.
"""

from __future__ import annotations

import bz2
from typing import Any

from ..errors import DriverError

MAX_CHUNK_SIZE = 1 << 27
"""Bytes of one decompressed chunk or message."""
MAX_RATIO = 50
"""Ratio of the sizes of a decompressed and a compressed file. That of CARMEN logs is 3 to 10."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of data compressed with zstd; serialised ROS 2 messages begin with a zero."""
ALWAYS_ALLOWED = 1 << 26
"""Bytes of a decompressed file, whatever the ratio."""


class DecompressionError(DriverError):
    """Data would become too large by decompression."""


def decompress(data: bytes, compression: str, limit: int = MAX_CHUNK_SIZE) -> bytes:
    """Decompress a chunk; `compression` is zstd, lz4 or bz2.

    Raises DecompressionError beyond `limit` bytes, ValueError if the compression is unknown or the data truncated, and
    other exceptions if it is damaged.
    """
    if compression == "zstd":
        import zstandard

        content: bytes = zstandard.ZstdDecompressor().stream_reader(data).read(limit + 1)
    elif compression in ("lz4", "bz2"):
        decompressor = _lz4_decompressor() if compression == "lz4" else bz2.BZ2Decompressor()
        content = decompressor.decompress(data, limit + 1)
        if len(content) <= limit and not decompressor.eof:
            raise ValueError("compressed data is truncated")
    else:
        raise ValueError(f"compression {compression!r} is unknown")
    if len(content) > limit:
        raise DecompressionError(f"a chunk of {len(data)} bytes decompresses to more than {limit / 1e6:.0f} MB")
    return content


def uncompressed_message(data: bytes) -> bytes:
    """Return a serialised ROS 2 message, decompressed if the recorder has compressed each message on its own.

    Only the bag's metadata say so, which are not read with a file that is opened on its own. Damaged data are returned
    as they are. Raises DecompressionError beyond MAX_CHUNK_SIZE.
    """
    if not data.startswith(ZSTD_MAGIC):
        return data
    try:
        return decompress(data, "zstd")
    except DecompressionError:
        raise
    except Exception:  # the decompressor raises its own
        return data


def allowed_size(compressed: int) -> int:
    """Return the bytes that a file of `compressed` bytes may have after decompression."""
    return max(ALWAYS_ALLOWED, MAX_RATIO * compressed)


def _lz4_decompressor() -> Any:
    import lz4.frame

    return lz4.frame.LZ4FrameDecompressor()

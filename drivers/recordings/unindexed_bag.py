"""Messages of a ROS 1 bag without its index: of a recorder that was killed (.bag.active), or a file cut short.

A bag of the version 2.0 is a sequence of records, some of them within chunks, and an index at its end. The records are
read in the order in which they were written. Those of an uncompressed chunk follow its header, so they are found also
if the recorder did not complete the chunk and left its length open.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

from ..timestamps import NANOSECONDS
from .decompression import decompress

MAGIC = b"#ROSBAG V2.0\n"

_MESSAGE, _INDEX, _CHUNK, _CONNECTION = b"\x02", b"\x04", b"\x05", b"\x07"
"""Operation codes of the records with messages, places of a chunk's messages, chunks of records, and topics."""
_INDEX_ENTRY = 12
"""Bytes of a message's place: its time and offset. Recorders of 2010 state a larger size of the record than it has."""

Fields = dict[bytes, bytes]
"""Fields of a record's header by name."""


def read_unindexed(
    path: Path, msgtypes: frozenset[str], topics: dict[str, str] | None = None
) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield topic, ROS type, time of reception (nanoseconds) and data of the messages of some types.

    All topics are added to `topics`, with their types, as soon as they are read.

    Raises ValueError at the first damage, also if the file ends within a record, and DecompressionError if a chunk
    would become too large.
    """
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError("not a bag of the version 2.0")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            connections: dict[bytes, tuple[str, str]] = {}
            for fields, data in _records(content, len(MAGIC)):
                if fields[b"op"] == _CONNECTION:
                    topic, msgtype = connections[fields.get(b"conn", b"")] = _topic_and_type(fields, data)
                    if topics is not None:
                        topics[topic] = msgtype
                elif fields[b"op"] == _MESSAGE:
                    topic, msgtype = connections.get(fields.get(b"conn", b""), ("", ""))
                    if msgtype in msgtypes:
                        seconds, nanoseconds = _unpack("<II", fields.get(b"time", b""))
                        yield topic, msgtype, seconds * NANOSECONDS + nanoseconds, data


def _records(content: mmap.mmap | bytes, start: int, in_chunk: bool = False) -> Iterator[tuple[Fields, bytes]]:
    """Yield header and data of the records from an offset on, those within chunks in place of the chunk."""
    at = start
    while at < len(content):
        header, at = _block(content, at)
        fields = _fields(header)
        if b"op" not in fields:  # such as the zeros of space that was reserved but not written
            raise ValueError("a record without operation code")
        if fields[b"op"] == _INDEX:
            at += 4 + _INDEX_ENTRY * _unpack("<I", fields.get(b"count", b""))[0]
            if at > len(content):
                raise ValueError("ends within a record")
        elif fields[b"op"] != _CHUNK:
            data, at = _block(content, at)
            yield fields, data
        elif in_chunk:
            raise ValueError("a chunk within a chunk")
        elif fields.get(b"compression") == b"none":
            at += 4  # the length of the chunk's data, which are records
        else:
            data, at = _block(content, at)
            yield from _records(_decompressed(data, fields), 0, in_chunk=True)


def _block(content: mmap.mmap | bytes, at: int) -> tuple[bytes, int]:
    """Return the bytes after the length at an offset, and the offset after them."""
    start = at + 4
    (length,) = _unpack("<I", content[at:start])
    if start + length > len(content):
        raise ValueError("ends within a record")
    return content[start : start + length], start + length


def _fields(header: bytes) -> Fields:
    fields: Fields = {}
    at = 0
    while at < len(header):
        field, at = _block(header, at)
        name, _, value = field.partition(b"=")
        fields[name] = value
    return fields


def _topic_and_type(fields: Fields, data: bytes) -> tuple[str, str]:
    try:
        package, name = _fields(data)[b"type"].decode().split("/")
        return fields[b"topic"].decode(), f"{package}/msg/{name}"
    except (KeyError, ValueError) as error:
        raise ValueError("a topic without name or type") from error


def _decompressed(data: bytes, fields: Fields) -> bytes:
    try:
        return decompress(data, fields.get(b"compression", b"").decode("ascii", "replace"))
    except (RuntimeError, OSError, EOFError) as error:  # of the libraries for lz4 and bz2
        raise ValueError("a chunk cannot be decompressed") from error


def _unpack(format: str, data: bytes) -> tuple[int, ...]:
    if len(data) < struct.calcsize(format):
        raise ValueError("ends within a record")
    return struct.unpack_from(format, data)

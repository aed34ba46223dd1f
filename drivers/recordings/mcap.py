"""MCAP files with ROS 2 messages: what this project records, and what Foxglove and ROS 2 open."""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Schema
from mcap.records import Message as Stored
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from ..errors import RecordingError
from ..messages import GroundTruth, Message, Odometry, Scan
from ..timestamps import to_nanoseconds
from .reader import is_stamp
from .ros_messages import (
    BEAMS,
    DIAGNOSTICS,
    LASER_SCAN,
    ODOMETRY,
    POSE,
    TRANSFORMS,
    Diagnostic,
    Encoder,
    Placing,
    decode,
    scan_of,
)
from .ros_reader import BEAMS_TOPIC, KINDS, TRUTH_TOPIC, Entry, RosRecording

FLUSH_PERIOD = 0.5
"""Seconds of wall time; what was written earlier survives the end of the process and of the power."""
ENCODINGS = ("cdr", "ros1")
MAGIC = b"\x89MCAP0\r\n"


class Mcap(RosRecording):
    """An MCAP file as a `Source`. One that ends early, because its writer was killed, is read up to its last
    whole chunk; that and damaged chunks are counted in the report.
    """

    def __len__(self) -> int:
        """The number of messages of the types that are read; 0 where the file has no summary."""
        try:
            with self.path.open("rb") as file:
                summary = make_reader(file).get_summary()
        except Exception:  # mcap raises whatever its parser trips over in a damaged file; the length is a mere hint
            return 0
        if summary is None or summary.statistics is None:
            return 0
        counts = summary.statistics.channel_message_counts
        kinds = {id: _kind(summary.schemas.get(channel.schema_id)) for id, channel in summary.channels.items()}
        return sum(count for id, count in counts.items() if kinds.get(id) in (LASER_SCAN, ODOMETRY, POSE))

    def _entries(self, final: bool) -> Iterator[Entry]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        number = 0
        for record in self._records(final):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Stored):
                number += 1
                channel = channels.get(record.channel_id)
                kind = _kind(schemas.get(channel.schema_id)) if channel else None
                if channel and kind in KINDS and channel.message_encoding in ENCODINGS:
                    yield Entry(number, channel.topic, kind, channel.message_encoding, record.log_time, record.data)

    def _records(self, final: bool) -> Iterator[McapRecord]:
        """All records, those within chunks included, as far as the file is whole."""
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise RecordingError(self.path, None, "is not an MCAP file")
            # Reads from the map end where the file ends, however long a damaged record says that it is.
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                reader = StreamReader(content, emit_chunks=True, record_size_limit=len(content))  # type: ignore[arg-type]
                records = iter(reader.records)
                while True:
                    try:
                        record = next(records, None)
                    except Exception:  # mcap raises whatever its parser trips over
                        if final:
                            self.skip(None, "file ends early or is damaged; it was read up to there")
                        return
                    if record is None:
                        return
                    yield from self._within(record, final) if isinstance(record, Chunk) else [record]

    def _within(self, chunk: Chunk, final: bool) -> list[McapRecord]:
        try:
            return breakup_chunk(chunk, validate_crc=True)
        except Exception:  # as above, and the decompressors' own
            if final:
                self.skip(None, "chunk is damaged")
            return []


def _kind(schema: Schema | None) -> str | None:
    """A schema's type name as ROS 2 writes it: ROS 1 leaves out the `msg`."""
    if schema is None:
        return None
    return schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")


class McapWriter:
    """Writes messages into an MCAP file, to be used in a `with` statement.

    What is read back is what was written, bit for bit, given that stamps are whole nanoseconds and headings
    are in [-pi, pi). A process that is killed loses the last second at most. Raises RecordingError where the
    file exists and is not to be overwritten, or cannot be written. Where the disk is full the file ends with what
    was flushed before, and can be read; nothing more can be written then.
    """

    def __init__(self, path: str | Path, overwrite: bool = False) -> None:
        self.path = Path(path)
        try:
            self._file = self.path.open("wb" if overwrite else "xb")
        except FileExistsError as error:
            raise RecordingError(self.path, None, "exists already") from error
        except OSError as error:
            raise RecordingError(self.path, None, f"cannot be written: {error.strerror}") from error
        self._encoder = Encoder()
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library="wclm-slam")
        self._channels: dict[str, int] = {}
        self._frames: dict[bytes | None, str] = {}
        self._flushed = time.monotonic()
        self._whole = 0  # bytes of the file after the last flush

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, message: Message) -> None:
        """Append a message; stamps should not decrease. Raises RecordingError where the stamp or the disk
        does not allow it.
        """
        if not is_stamp(message.stamp):
            raise RecordingError(self.path, None, f"stamp {message.stamp} cannot be recorded")
        if isinstance(message, Scan) and not len(message.ranges):
            raise RecordingError(self.path, None, "a scan without beams cannot be recorded")
        with self._keeping_what_is_whole():
            self._write(message, to_nanoseconds(message.stamp))
            self._flush_now_and_then()

    def write_diagnostics(self, stamp: float, diagnostics: Sequence[Diagnostic]) -> None:
        """Append how the parts of the robot are doing; readers of scans and odometry pass over it."""
        with self._keeping_what_is_whole():
            data = self._encoder.diagnostics(stamp, diagnostics)
            self._add("/diagnostics", DIAGNOSTICS, to_nanoseconds(stamp), data)
            self._flush_now_and_then()

    def close(self) -> None:
        """Finish the file; further calls do nothing."""
        if self._file.closed:
            return
        with self._keeping_what_is_whole():
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()

    def _flush_now_and_then(self) -> None:
        if time.monotonic() - self._flushed >= FLUSH_PERIOD:
            self._writer.flush()  # type: ignore[no-untyped-call]
            os.fsync(self._file.fileno())
            self._whole = self._file.tell()
            self._flushed = time.monotonic()

    @contextmanager
    def _keeping_what_is_whole(self) -> Iterator[None]:
        """After a failure the file is closed and ends where it was whole; raises RecordingError."""
        if self._file.closed:
            raise RecordingError(self.path, None, "is closed")
        try:
            yield
        except OSError as error:
            with suppress(OSError):
                self._file.close()  # which tries once more to write what it holds
            with suppress(OSError):
                os.truncate(self.path, self._whole)
            raise RecordingError(self.path, None, f"cannot be written: {error.strerror}") from error

    def _write(self, message: Message, stamp: int) -> None:
        if isinstance(message, Odometry):
            self._add("/odom", ODOMETRY, stamp, self._encoder.odometry(message))
        elif isinstance(message, GroundTruth):
            self._add(TRUTH_TOPIC, POSE, stamp, self._encoder.truth(message))
        else:
            data = self._encoder.scan(message, self._frame(message, stamp))
            if not _holds(data, message):
                self._add(BEAMS_TOPIC, BEAMS, stamp, self._encoder.beams(message))
            self._add("/scan", LASER_SCAN, stamp, data)

    def _frame(self, scan: Scan, stamp: int) -> str:
        """The frame of a scan's lidar; a new one is placed on the robot, where the scan says how."""
        key = None if scan.mount is None else scan.mount.tobytes()
        if key not in self._frames:
            count = len(self._frames)
            self._frames[key] = "laser" if count == 0 else f"laser_{count + 1}"
            if scan.mount is not None:
                data = self._encoder.mount(scan.stamp, scan.mount, self._frames[key])
                self._add("/tf_static", TRANSFORMS, stamp, data)
        return self._frames[key]

    def _add(self, topic: str, kind: str, stamp: int, data: bytes) -> None:
        if topic not in self._channels:
            definition = self._encoder.definition(kind).encode()
            schema = self._writer.register_schema(kind, "ros2msg", definition)
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
        self._writer.add_message(self._channels[topic], log_time=stamp, publish_time=stamp, data=data)


def _holds(data: bytes, scan: Scan) -> bool:
    """Whether a LaserScan decodes to the scan bit for bit."""
    try:
        same = scan_of(decode(data, LASER_SCAN, "cdr"), to_nanoseconds(scan.stamp), Placing())
    except ValueError:
        return False
    limits = (same.range_min, same.range_max) == (scan.range_min, scan.range_max)
    return limits and all(
        np.array_equal(a, b, equal_nan=True)
        for a, b in (
            (same.angles, scan.angles),
            (same.ranges, scan.ranges),
            (same.time_offsets, scan.time_offsets),
        )
    )

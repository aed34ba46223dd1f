"""Reader and writer for MCAP files with ROS 2 messages: the format of this project's recordings.

Foxglove and ROS 2 open them too.
"""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from ..errors import RecordingError
from ..message_arrays import with_own_arrays
from ..messages import GroundTruth, Message, Odometry, Scan, YawRate
from ..timestamps import to_nanoseconds
from .chunk_indexes import ChunkIndexes
from .decompression import DecompressionError, decompress
from .ros_encoder import BASE_FRAME, ODOMETRY_FRAME, Diagnostic, RosEncoder
from .ros_messages import (
    BEAMS,
    DIAGNOSTICS,
    IMU,
    LASER_SCAN,
    ODOMETRY,
    POSE,
    TRANSFORMS,
    LidarMount,
    decode,
    scan_of,
)
from .ros_reader import GROUND_TRUTH_TOPIC, RosReader
from .ros_scans import beams_topic
from .stamp_units import is_valid_stamp
from .stored_messages import StoredMessage

FLUSH_PERIOD = 0.5
"""Seconds of wall time between flushes; flushed messages survive a killed process or a power failure."""
SCAN_TOPICS = ("/scan", "/scan_2")
"""Topics of the scans that are written, by the number of the lidar."""
ENCODINGS = ("cdr", "ros1")
MAGIC = b"\x89MCAP0\r\n"


class McapReader(RosReader):
    """MCAP file as a `Source`. A truncated file, whose writer was killed, is read up to its last complete chunk;
    truncation and damaged chunks are counted in the report.
    """

    def __len__(self) -> int:
        """Return the number of messages of the supported types; 0 if the file has no summary."""
        try:
            with self.path.open("rb") as file:
                summary = make_reader(file).get_summary()
        except Exception:  # mcap raises exceptions of any type for damaged files; the length is only approximate
            return 0
        if summary is None or summary.statistics is None:
            return 0
        counts = summary.statistics.channel_message_counts
        types = {id: _type_name(summary.schemas.get(channel.schema_id)) for id, channel in summary.channels.items()}
        return sum(count for id, count in counts.items() if types.get(id) in (LASER_SCAN, ODOMETRY, POSE))

    def _stored_messages(self, final: bool) -> Iterator[StoredMessage]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        number = 0
        for record in self._records(final):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
                self._stored_topics[record.topic] = _type_name(schemas.get(record.schema_id)) or "?"
            elif isinstance(record, McapMessage):
                number += 1
                channel = channels.get(record.channel_id)
                msgtype = _type_name(schemas.get(channel.schema_id)) if channel else None
                if channel and msgtype in self._types and channel.message_encoding in ENCODINGS:
                    yield StoredMessage(
                        number, channel.topic, msgtype, channel.message_encoding, record.log_time, record.data
                    )

    def _records(self, final: bool) -> Iterator[McapRecord]:
        """Yield all records, including those within chunks, up to the first damage outside of a chunk."""
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise RecordingError(self.path, None, "is not an MCAP file")
            # Memory-mapped, since a damaged record may state any length: reads end at the end of the file.
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                reader = StreamReader(content, emit_chunks=True, record_size_limit=len(content))  # type: ignore[arg-type]
                records = iter(reader.records)
                while True:
                    try:
                        record = next(records, None)
                    except Exception:  # see __len__
                        if final:
                            self.skip(None, "file is truncated or damaged; it was read up to this point")
                        return
                    if record is None:
                        return
                    yield from self._records_of(record, final) if isinstance(record, Chunk) else [record]

    def _records_of(self, chunk: Chunk, final: bool) -> list[McapRecord]:
        try:
            if chunk.compression:
                content = decompress(chunk.data, chunk.compression)
                chunk = replace(chunk, compression="", data=content)
            return breakup_chunk(chunk, validate_crc=True)
        except DecompressionError as error:
            raise RecordingError(self.path, None, str(error)) from error
        except Exception:  # see __len__; decompressors raise their own
            if final:
                self.skip(None, "chunk is damaged")
            return []


def _type_name(schema: Schema | None) -> str | None:
    """Return a schema's type name in the notation of ROS 2; ROS 1 omits the `msg`."""
    if schema is None:
        return None
    return schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")


class McapWriter:
    """Writer of messages into an MCAP file, to be used in a `with` statement.

    Messages are read back bit for bit if their stamps are whole nanoseconds and their headings in [-pi, pi). A killed
    process loses at most the last second. Raises RecordingError if the file exists and `overwrite` is not set, or if it
    cannot be written. If the disk is full, the file is closed and ends with the last flushed message; it can be read.
    """

    def __init__(self, path: str | Path, overwrite: bool = False) -> None:
        self.path = Path(path)
        try:
            self._file = self.path.open("wb" if overwrite else "xb")
        except FileExistsError as error:
            raise RecordingError(self.path, None, "exists already") from error
        except OSError as error:
            raise RecordingError(self.path, None, f"cannot be written: {error.strerror}") from error
        self._encoder = RosEncoder()
        self._writer = Writer(self._file)
        self._writer._Writer__chunk_indices = ChunkIndexes()  # type: ignore[attr-defined]  # a list grows faster
        self._channels: dict[str, int] = {}
        self._frames: dict[bytes | None, str] = {}  # mount -> name of the lidar's frame
        self._flush_time = time.monotonic()
        self._flushed_size = 0  # bytes of the file after the last flush
        with self._truncating_on_error():
            self._writer.start(profile="ros2", library="wclm-slam")
            self._flush()  # so that the file can be read even if the first messages cannot be written

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, message: Message) -> None:
        """Append a message; stamps should not decrease. Arrays may also be lists, or of other types of numbers.

        Raises MessageError if its arrays or numbers have a wrong type or shape, and RecordingError if the stamp is
        invalid, a scan has no beams, or the file cannot be written.
        """
        message = with_own_arrays(message)
        if not is_valid_stamp(message.stamp):
            raise RecordingError(self.path, None, f"stamp {message.stamp} cannot be recorded")
        if isinstance(message, Scan) and not len(message.ranges):
            raise RecordingError(self.path, None, "a scan without beams cannot be recorded")
        with self._truncating_on_error():
            self._write(message, to_nanoseconds(message.stamp))
            self._flush_periodically()

    def write_diagnostics(self, stamp: float, diagnostics: Sequence[Diagnostic]) -> None:
        """Append the state of the robot's parts; readers of scans and odometry ignore it."""
        with self._truncating_on_error():
            data = self._encoder.diagnostics(stamp, diagnostics)
            self._add("/diagnostics", DIAGNOSTICS, to_nanoseconds(stamp), data)
            self._flush_periodically()

    def close(self) -> None:
        """Finish the file; further calls have no effect."""
        if self._file.closed:
            return
        with self._truncating_on_error():
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()

    def _flush_periodically(self) -> None:
        if time.monotonic() - self._flush_time >= FLUSH_PERIOD:
            self._flush()

    def _flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        os.fsync(self._file.fileno())
        self._flushed_size = self._file.tell()
        self._flush_time = time.monotonic()

    @contextmanager
    def _truncating_on_error(self) -> Iterator[None]:
        """Close the file and truncate it to its flushed part if writing fails; raises RecordingError."""
        if self._file.closed:
            raise RecordingError(self.path, None, "is closed")
        try:
            yield
        except OSError as error:
            with suppress(OSError):
                self._file.close()  # tries to write its buffer again
            with suppress(OSError):
                os.truncate(self.path, self._flushed_size)
            raise RecordingError(self.path, None, f"cannot be written: {error.strerror}") from error

    def _write(self, message: Message, stamp: int) -> None:
        if isinstance(message, Odometry):
            self._add("/odom", ODOMETRY, stamp, self._encoder.odometry(message))
            moved = self._encoder.transform(message.stamp, ODOMETRY_FRAME, BASE_FRAME, message.pose)
            self._add("/tf", TRANSFORMS, stamp, moved)  # viewers place scans by it
        elif isinstance(message, YawRate):
            self._add("/imu", IMU, stamp, self._encoder.yaw_rate(message))
        elif isinstance(message, GroundTruth):
            self._add(GROUND_TRUTH_TOPIC, POSE, stamp, self._encoder.ground_truth(message))
        elif isinstance(message, Scan):
            data = self._encoder.scan(message, self._frame(message, stamp))
            topic = SCAN_TOPICS[message.lidar]
            if not _is_exact(data, message):
                self._add(beams_topic(topic), BEAMS, stamp, self._encoder.beams(message))
            self._add(topic, LASER_SCAN, stamp, data)

    def _frame(self, scan: Scan, stamp: int) -> str:
        """Return the frame name of a scan's lidar; write the transform of a new frame if the mount is known."""
        key = None if scan.mount is None else scan.mount.tobytes()
        if key not in self._frames:
            count = len(self._frames)
            self._frames[key] = "laser" if count == 0 else f"laser_{count + 1}"
            if scan.mount is not None:
                data = self._encoder.transform(scan.stamp, BASE_FRAME, self._frames[key], scan.mount)
                self._add("/tf_static", TRANSFORMS, stamp, data)
        return self._frames[key]

    def _add(self, topic: str, msgtype: str, stamp: int, data: bytes) -> None:
        if topic not in self._channels:
            definition = self._encoder.definition(msgtype).encode()
            schema = self._writer.register_schema(msgtype, "ros2msg", definition)
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
        self._writer.add_message(self._channels[topic], log_time=stamp, publish_time=stamp, data=data)


def _is_exact(data: bytes, scan: Scan) -> bool:
    """Return true if a serialised LaserScan decodes to the scan bit for bit."""
    try:
        decoded = scan_of(decode(data, LASER_SCAN, "cdr"), to_nanoseconds(scan.stamp), LidarMount())
    except ValueError:
        return False
    limits = (decoded.range_min, decoded.range_max) == (scan.range_min, scan.range_max)
    return limits and all(
        np.array_equal(a, b, equal_nan=True)
        for a, b in (
            (decoded.angles, scan.angles),
            (decoded.ranges, scan.ranges),
            (decoded.time_offsets, scan.time_offsets),
        )
    )

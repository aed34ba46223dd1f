"""Where rows of the log go: a file, or several one after the other, and those who look on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias
from uuid import uuid4

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...errors import OutputError
from .files import part_name
from .server import ViewerServer

APPLICATION = "wclm-slam"  # the viewer keeps layouts by this name
SENSOR_TIME = "sensor_time"
EPOCH_STAMPS = 1e8  # stamps above are seconds since 1970, stamps below count from the recording's own start
SERVER_MEMORY = "25%"  # of the computer's: what viewers that come late are shown; older rows are in the file only
FLUSH_PERIOD = 0.5  # seconds; live, shorter ones cost kilobytes each for their chunks, and viewers see no more
PART_SIZE = 200_000_000  # bytes, after which another file is begun: hours of driving
GATHERED = 64  # rows at most that are sent together
GATHERING_PERIOD = 0.5  # seconds at most that a row waits for others, as long as others come
MOST_PARTS = 40  # files; the oldest but the first is removed then: a log that is never stopped must not fill the disk

Archetype: TypeAlias = Any  # Rerun has no common type for what can be logged
Columns: TypeAlias = Callable[[list[Any]], Iterable[Any]]


class Recording:
    """A Rerun recording, in files of at most about `part_size` bytes, and at a server if there is one.

    Every file holds what never changes, so that each can be read by itself; opened together they are one recording. The
    server has a stream of its own: a file cannot be changed for another without cutting viewers off.
    """

    def __init__(
        self, path: Path, layout: rrb.Blueprint, server: ViewerServer | None = None, part_size: int = PART_SIZE
    ) -> None:
        """Open the file. Raises OutputError where it cannot be written."""
        identity = str(uuid4())
        self._path, self._part_size = path, part_size
        self._part = 1
        self._layout = layout
        self._lasting: dict[tuple[str, str], Archetype] = {}
        self._now: dict[str, int] = {}
        self._gathered: dict[str, Gathered] = {}
        self._file = _stream(identity)
        self._streams = [self._file]
        self._name = ""
        self._facts: tuple[str, rr.AnyValues] | None = None
        try:
            self._file.set_sinks(rr.FileSink(path), default_blueprint=layout)
            if server is not None:
                server.release()
                watched = _stream(identity)
                sink = rr.GrpcServerSink(server.address, server.port, server_memory_limit=SERVER_MEMORY)
                watched.set_sinks(sink, default_blueprint=layout)
                self._streams.append(watched)
        except (OSError, RuntimeError) as error:
            raise OutputError(f"{path}: cannot write the review log: {error}") from error

    def name(self, name: str) -> None:
        """How viewers list the recording."""
        self._name = name
        for stream in self._streams:
            stream.send_recording_name(name)

    def describe(self, name: str, facts: Mapping[str, Any]) -> None:
        """Properties of the whole recording."""
        self._facts = name, rr.AnyValues(drop_untyped_nones=True, **facts)
        for stream in self._streams:
            stream.send_property(*self._facts)

    def log(self, entity: str, row: Archetype) -> None:
        """Log a row at the time that was set last."""
        for stream in self._streams:
            stream.log(entity, row)

    def gather(self, entity: str, value: object, columns: Columns) -> None:
        """Log a row together with others of its entity, soon: a tenth of the cost of a row each.

        `columns` makes what Rerun takes of many values. All rows of an entity have the same timelines.
        """
        gathered = self._gathered.setdefault(entity, Gathered(columns))
        gathered.values.append(value)
        gathered.times.append(self._now.copy())
        if len(gathered.values) == GATHERED or time.monotonic() - gathered.since > GATHERING_PERIOD:
            self._send(entity, self._gathered.pop(entity))

    def _send(self, entity: str, gathered: Gathered) -> None:
        indexes = [_time_column(timeline, [row[timeline] for row in gathered.times]) for timeline in gathered.times[0]]
        columns = list(gathered.columns(gathered.values))
        for stream in self._streams:
            stream.send_columns(entity, indexes=indexes, columns=columns)

    def _send_all(self) -> None:
        for entity in list(self._gathered):
            self._send(entity, self._gathered.pop(entity))

    def keep(self, entity: str, row: Archetype) -> None:
        """Log what holds for all times, and is in every file."""
        self._lasting[entity, type(row).__name__] = row
        for stream in self._streams:
            stream.log(entity, row, static=True)

    def set_time(self, stamp: float, **sequences: int | None) -> None:
        """Stamp the next rows with the recording's time (seconds), and with sequences; None takes one out again."""
        nanoseconds = round(1e9 * stamp)
        self._now = {SENSOR_TIME: nanoseconds} | {name: value for name, value in sequences.items() if value is not None}
        for stream in self._streams:
            if stamp > EPOCH_STAMPS:
                stream.set_time(SENSOR_TIME, timestamp=np.datetime64(nanoseconds, "ns"))
            else:
                stream.set_time(SENSOR_TIME, duration=np.timedelta64(nanoseconds, "ns"))
            for timeline, number in sequences.items():
                if number is None:
                    stream.disable_timeline(timeline)
                else:
                    stream.set_time(timeline, sequence=number)

    def lay_out(self, layout: rrb.Blueprint) -> None:
        """Show the recording in another way from now on; what viewers have rearranged is lost."""
        self._layout = layout
        for stream in self._streams:
            stream.send_blueprint(layout)

    def begin_part_if_full(self) -> None:
        """Go on in another file once the present one is large enough."""
        if part_name(self._path, self._part).stat().st_size < self._part_size:
            return
        self._send_all()
        self._part += 1
        self._file.set_sinks(rr.FileSink(part_name(self._path, self._part)), default_blueprint=self._layout)
        if self._name:
            self._file.send_recording_name(self._name)
        if self._facts is not None:
            self._file.send_property(*self._facts)
        for (entity, _), row in self._lasting.items():
            self._file.log(entity, row, static=True)
        if self._part > MOST_PARTS:
            part_name(self._path, self._part - MOST_PARTS + 1).unlink(missing_ok=True)

    def close(self) -> None:
        """Write the file's footer. Raises what Rerun raises where it could not be written, on a full disk for one."""
        self._send_all()
        for stream in self._streams:
            stream.flush()  # disconnecting does not raise
            stream.disconnect()


@dataclass(slots=True, eq=False)
class Gathered:
    """Rows of an entity that wait to be sent together, with their times by timeline."""

    columns: Columns
    values: list[Any] = field(default_factory=list)
    times: list[dict[str, int]] = field(default_factory=list)
    since: float = field(default_factory=time.monotonic)


def _time_column(timeline: str, values: list[int]) -> rr.TimeColumn:
    if timeline != SENSOR_TIME:
        return rr.TimeColumn(timeline, sequence=values)
    if values[0] > 1e9 * EPOCH_STAMPS:
        return rr.TimeColumn(timeline, timestamp=np.array(values).astype("datetime64[ns]"))
    return rr.TimeColumn(timeline, duration=np.array(values).astype("timedelta64[ns]"))


def _stream(identity: str) -> rr.RecordingStream:
    batching = rr.ChunkBatcherConfig(flush_tick=FLUSH_PERIOD)
    stream = rr.RecordingStream(APPLICATION, recording_id=identity, batcher_config=batching)
    stream.set_log_time_enabled(False)
    return stream

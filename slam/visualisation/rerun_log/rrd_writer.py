"""Write rows of the log to a sequence of .rrd files and to connected viewers."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias
from uuid import uuid4

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...errors import OutputError
from ...io.disk_reserve import free_space
from .log_files import part_name
from .row_batches import Archetype, Row, RowBatch, Values, columns_of
from .timelines import CANDIDATE, CLOSURE, KEYFRAME, SENSOR_TIME, is_date
from .viewer import ViewerServer

APPLICATION = "wclm-slam"  # the viewer stores layouts by this name
SERVER_MEMORY = "256MB"  # rows kept for viewers that connect late: some hours of driving; older ones are in the file
FLUSH_PERIOD = 0.5  # seconds; shorter periods cost kilobytes per chunk with a live viewer and show nothing sooner
# Bytes after which another file is started: an hour of driving. Rerun keeps an index of the open file in memory, about
# as large as the rows if these are few in each chunk, as in familiar places.
PART_SIZE = 50_000_000
# Rows written together, and seconds that a row between keyframes or of a plot waits for further rows of its entity. In
# memory, every chunk takes 1 kB until the file ends: with few rows in each, the memory of a run grows faster. A killed
# run lacks the rows that wait.
MAX_BATCH_ROWS, MAX_BATCH_AGE = 512, 30.0
# Seconds that other rows of a recording wait, of which a minute is mapped in a second and which can be mapped again:
# writing them takes a sixth of the time of the log less than with FLUSH_PERIOD.
MAX_RECORDED_AGE = 2.0
MAX_LIVE_BATCH_AGE = 1.0  # seconds that a row waits for further ones before viewers receive it
MAX_STEP_TEXTS = 1000  # rows of the text log that a step of CANDIDATE or CLOSURE repeats; older ones are left out
MAX_PARTS = 160  # files; then the oldest but the first is deleted, so that an endless run does not fill the disk
# Bytes of free space below which the file ends, so that it is complete and the recording beside it goes on.
# Origin: chosen, half a minute of log and recording; not measured.
MIN_FREE_SPACE = 4_000_000

_logger = logging.getLogger(__name__)

_BatchKey: TypeAlias = tuple[str, str, bool]
"""Entity, archetype, and whether the rows are those of keyframes."""


class RrdWriter:
    """A Rerun recording in files of about `part_size` bytes each, and at a server if one is given.

    Every file contains the static rows, so that it can be read by itself; opened together the files are one recording.
    The server has a separate stream, because replacing a stream's file would disconnect the viewers. The file ends
    before the disk is full: Rerun would report that only at the end, and what it could not write would be missing.

    Rows are stamped with the sensor time and, at keyframes, the number of the keyframe. The timelines CANDIDATE and
    CLOSURE have steps instead: `log_step` repeats the last row of everything that has changed since the last step.
    """

    def __init__(
        self,
        path: Path,
        layout: rrb.Blueprint,
        server: ViewerServer | None = None,
        part_size: int = PART_SIZE,
        max_age: float = FLUSH_PERIOD,
    ) -> None:
        """Open the file. Raises OutputError if it cannot be written.

        `max_age` is the time (seconds) that a batched row waits if it has no other.
        """
        identity = str(uuid4())
        self._path, self._part_size, self._max_age = path, part_size, max_age
        self._part = 1
        self._layout = layout
        self._static: dict[tuple[str, str], Archetype] = {}
        self._now: dict[str, int] = {}
        self._dates: bool | None = None  # true if sensor times are written as dates, as the first one is
        self._stream_times: dict[str, int] = {}  # current time of the streams
        self._batches: dict[_BatchKey, RowBatch] = {}
        self._changed: dict[str, dict[tuple[str, ...], Archetype | Row]] = {CANDIDATE: {}, CLOSURE: {}}
        self._texts = 0  # rows of text logs so far, modulo MAX_STEP_TEXTS
        self._file = _open_stream(identity)
        self._live: rr.RecordingStream | None = None
        self._streams = [self._file]
        self._grown = False  # rows were written into the file since it was looked at
        self.file_ended = False  # because the disk is nearly full; viewers still receive all
        self._name = ""
        self._properties: tuple[str, rr.AnyValues] | None = None
        try:
            self._file.set_sinks(rr.FileSink(path), default_blueprint=layout)
            if server is not None:
                server.release()
                self._live = _open_stream(identity)
                sink = rr.GrpcServerSink(server.address, server.port, server_memory_limit=SERVER_MEMORY)
                self._live.set_sinks(sink, default_blueprint=layout)
                self._streams.append(self._live)
        except (OSError, RuntimeError) as error:
            raise OutputError(f"{path}: cannot write the review log: {error}") from error

    def set_name(self, name: str) -> None:
        """Set the name under which viewers list the recording."""
        self._name = name
        for stream in self._streams:
            stream.send_recording_name(name)

    def set_properties(self, name: str, values: Mapping[str, Any]) -> None:
        """Set properties of the whole recording."""
        self._properties = name, rr.AnyValues(drop_untyped_nones=True, **values)
        for stream in self._streams:
            stream.send_property(*self._properties)

    def log(self, entity: str, row: Archetype) -> None:
        """Log a row at the current time."""
        self._send_waiting(entity)
        self._set_stream_times()
        self._grown = True
        for stream in self._streams:
            stream.log(entity, row)
        self._remember(entity, row)

    def log_batched(
        self, entity: str, archetype: type[Archetype], *, max_age: float | None = None, **components: Values
    ) -> None:
        """Log a row of an archetype together with later rows of its entity, at a tenth of the cost of single rows.

        All rows of an entity and archetype must have the same components. It is written after `max_age` seconds (None:
        those of the writer), or as soon as another row of the entity is logged with `log`.
        """
        now, row = time.monotonic(), Row(archetype, components)
        key = entity, archetype.__name__, KEYFRAME in self._now
        batch = self._batches.get(key)
        if batch is None:
            age = self._max_age if max_age is None else max_age
            batch = self._batches[key] = RowBatch(now, now, age, bool(self._dates))
        batch.rows.append(row)
        batch.times.append(self._now)
        self._remember(entity, row)
        self._send_if_due(key, now)

    def clear(self, entity: str) -> None:
        """Remove everything at and below an entity at the current time."""
        for waiting in {waiting for waiting, *_ in self._batches if f"{waiting}/".startswith(f"{entity}/")}:
            self._send_waiting(waiting)
        self.log(entity, rr.Clear(recursive=True))

    def send_due(self) -> None:
        """Write the batched rows that have waited long enough."""
        now = time.monotonic()
        for key in list(self._batches):
            self._send_if_due(key, now)

    def _remember(self, entity: str, row: Archetype | Row) -> None:
        """Keep a row of a keyframe for the next steps; a text log consists of all its rows."""
        if KEYFRAME not in self._now:
            return
        archetype = row.archetype if isinstance(row, Row) else type(row)
        key: tuple[str, ...] = entity, archetype.__name__
        if archetype is rr.TextLog:
            self._texts = (self._texts + 1) % MAX_STEP_TEXTS
            key = *key, str(self._texts)
        for changed in self._changed.values():
            changed.pop(key, None)  # so that the rows are in the order in which they were logged
            changed[key] = row

    def log_step(self, timeline: str, number: int) -> None:
        """Log step `number` of CANDIDATE or CLOSURE: what has changed since its last step, as it is now."""
        changed, self._changed[timeline] = self._changed[timeline], {}
        self._stream_times = {}
        for stream in self._streams:
            for other in (SENSOR_TIME, KEYFRAME):
                stream.disable_timeline(other)
            stream.set_time(timeline, sequence=number)
            for (entity, *_), row in changed.items():
                if isinstance(row, Row):
                    index = rr.TimeColumn(timeline, sequence=[number])
                    stream.send_columns(entity, indexes=[index], columns=columns_of([row]))
                else:
                    stream.log(entity, row)
            stream.disable_timeline(timeline)

    def _send_if_due(self, key: _BatchKey, now: float) -> None:
        batch = self._batches[key]
        if len(batch.rows) == MAX_BATCH_ROWS or now - batch.started > batch.max_age:
            self._send(key)
        elif self._live is not None and now - batch.shown_at > MAX_LIVE_BATCH_AGE:
            batch.shown_at = now
            self._show(key[0], batch)

    def _send(self, key: _BatchKey) -> None:
        """Write a batch, and send viewers what they have not received of it."""
        batch = self._batches.pop(key)
        self._grown = True
        if not self.file_ended:
            batch.send(self._file, key[0], 0)
        self._show(key[0], batch)

    def _show(self, entity: str, batch: RowBatch) -> None:
        """Send viewers the rows of a batch that they have not received."""
        if self._live is not None and batch.shown < len(batch.rows):
            batch.send(self._live, entity, batch.shown)
            batch.shown = len(batch.rows)

    def _send_waiting(self, entity: str) -> None:
        """Write the batched rows of an entity: of two rows with the same time, viewers show the one written last."""
        for key in [key for key in self._batches if key[0] == entity]:
            self._send(key)

    def _send_all(self) -> None:
        for key in list(self._batches):
            self._send(key)

    def log_static(self, entity: str, row: Archetype) -> None:
        """Log a row that is valid at all times; it is repeated in every file."""
        self._static[entity, type(row).__name__] = row
        for stream in self._streams:
            stream.log(entity, row, static=True)

    def set_time(self, stamp: float, keyframe: int | None) -> None:
        """Set the time of the next rows: the sensor time (seconds) and the keyframe, None between keyframes."""
        nanoseconds = round(1e9 * stamp)
        if self._dates is None:  # a timeline of two types would damage the log
            self._dates = is_date(nanoseconds)
        self._now = {SENSOR_TIME: nanoseconds} | ({} if keyframe is None else {KEYFRAME: keyframe})

    def _set_stream_times(self) -> None:
        """Set the current time of the streams, if it has changed."""
        if self._stream_times is self._now:
            return
        self._stream_times = self._now
        nanoseconds, keyframe = self._now[SENSOR_TIME], self._now.get(KEYFRAME)
        for stream in self._streams:
            if self._dates:
                stream.set_time(SENSOR_TIME, timestamp=np.datetime64(nanoseconds, "ns"))
            else:
                stream.set_time(SENSOR_TIME, duration=np.timedelta64(nanoseconds, "ns"))
            if keyframe is None:
                stream.disable_timeline(KEYFRAME)
            else:
                stream.set_time(KEYFRAME, sequence=keyframe)

    def set_layout(self, layout: rrb.Blueprint) -> None:
        """Replace the layout; changes that viewers have made to it are lost."""
        self._layout = layout
        for stream in self._streams:
            stream.send_blueprint(layout)

    def manage_files(self) -> None:
        """Continue in another file if the current one has the part size; end it if the disk is nearly full.

        Only looks at the file if rows were written since the last time: between keyframes they wait for each other.
        """
        if self.file_ended or not self._grown:
            return
        self._grown = False
        path = part_name(self._path, self._part)
        if free_space(path.parent) < MIN_FREE_SPACE:
            self._end_file(path)
        elif path.stat().st_size >= self._part_size:
            self._begin_part()

    def _end_file(self, path: Path) -> None:
        """Write the footer of the file and tell why. Raises Rerun's error if that fails."""
        self._send_all()
        self.file_ended = True
        self._streams.remove(self._file)
        _logger.warning("%s ends here, as its disk is nearly full; mapping continues", path.name)
        _finish(self._file)

    def _begin_part(self) -> None:
        self._send_all()
        self._part += 1
        self._file.set_sinks(rr.FileSink(part_name(self._path, self._part)), default_blueprint=self._layout)
        if self._name:
            self._file.send_recording_name(self._name)
        if self._properties is not None:
            self._file.send_property(*self._properties)
        for (entity, _), row in self._static.items():
            self._file.log(entity, row, static=True)
        if self._part > MAX_PARTS:
            part_name(self._path, self._part - MAX_PARTS + 1).unlink(missing_ok=True)

    def close(self) -> None:
        """Write the file's footer. Raises Rerun's error if that fails, for example on a full disk."""
        self._send_all()
        for stream in self._streams:
            _finish(stream)


def _finish(stream: rr.RecordingStream) -> None:
    stream.flush()  # disconnecting alone raises no error
    stream.disconnect()


def _open_stream(identity: str) -> rr.RecordingStream:
    batching = rr.ChunkBatcherConfig(flush_tick=FLUSH_PERIOD)
    stream = rr.RecordingStream(APPLICATION, recording_id=identity, batcher_config=batching)
    stream.set_log_time_enabled(False)
    return stream

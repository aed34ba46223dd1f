"""The review log as a sink of the pipeline: events go into a queue, a thread of its own logs them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType

import numpy as np

from ...events import (
    Event,
    Finished,
    GroundTruthReceived,
    KeyframeAdded,
    LoopDecided,
    ScanTracked,
    StateChanged,
    WallsMerged,
    WallsRemoved,
)
from .server import ViewerServer

BUSY = 500  # events waiting, about a second of work: from here on scans are left out
OVERRUN = 5_000  # events waiting: the log has stalled, a full disk perhaps; from here on only what is seldom is kept
SELDOM = (LoopDecided, WallsMerged, WallsRemoved, StateChanged, Finished)
"""What is never left out: it comes so seldom that even the events of a day can wait."""

_logger = logging.getLogger(__name__)


class ReviewLog:
    """Writes the pipeline's events to a Rerun recording, without ever holding the pipeline up.

    While the log cannot keep up, scan points and the robot's way between keyframes are left out and counted; keyframes,
    maps and notices follow should it stall, decisions on loops never. Nothing that goes wrong while logging reaches the
    pipeline: it is reported once, by `close`.

    path        the .rrd file to write; an existing one is overwritten. A long log goes on in others beside it
    config      the settings, as TOML, to show beside the map
    recording   what was mapped, the name under which the viewer lists the log
    versions    package names and their versions
    server      where viewers can look on, however late they come
    seed        of the randomness in what was run, if there is any
    part_size   bytes after which another file is begun
    """

    def __init__(
        self,
        path: Path,
        *,
        config: str = "",
        recording: str = "",
        versions: Mapping[str, str] | None = None,
        server: ViewerServer | None = None,
        seed: int | None = None,
        part_size: int | None = None,
    ) -> None:
        """Open the log. Raises OutputError where `path` cannot be written."""
        # Rerun is imported here, and only for those who want a log
        from .log import EventLog
        from .recording import PART_SIZE

        self.path = path
        self.thinned = 0  # events that were left out, or lost their points, while the log was busy
        self.lost = 0  # events lost after the log had stalled
        self.failures = 0  # events that could not be logged
        self.first_failure: str | None = None
        self._queue: SimpleQueue[Event | None] = SimpleQueue()
        self._closed = False
        size = PART_SIZE if part_size is None else part_size
        self._log = EventLog(path, config, recording, versions or {}, server, size, seed)
        self._worker = threading.Thread(target=self._work, name="review log", daemon=True)
        self._worker.start()

    def left_out(self) -> dict[str, int]:
        """How many events are not in the log as they were told, by what became of them."""
        return {"thinned": self.thinned, "lost": self.lost, "failed": self.failures}

    @property
    def waiting(self) -> int:
        """Events that are not logged yet."""
        return self._queue.qsize()

    def handle(self, event: Event) -> None:
        """Take one event: microseconds, whatever the log is doing. Events after `close` are ignored."""
        if self._closed:
            return
        waiting = self.waiting
        if waiting >= OVERRUN and not isinstance(event, SELDOM):
            self.lost += 1
            return
        if waiting >= BUSY:
            if isinstance(event, ScanTracked | GroundTruthReceived):
                self.thinned += 1
                return
            if isinstance(event, KeyframeAdded):
                self.thinned += 1
                event = replace(event, points=np.empty((0, 2)))
        self._queue.put(event)

    def close(self) -> None:
        """Log what is waiting, finish the file and report what went wrong. Closing again does nothing."""
        if self._closed:
            return
        self._closed = True
        self._queue.put(None)
        self._worker.join()
        if self.failures or self.lost:
            _logger.error(
                "%s is incomplete: %d events could not be logged (first: %s), %d were lost because logging stalled",
                self.path,
                self.failures,
                self.first_failure,
                self.lost,
            )

    def __enter__(self) -> ReviewLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _work(self) -> None:
        while (event := self._queue.get()) is not None:
            with self._failures_counted(type(event).__name__):
                self._log.write(event)
        with self._failures_counted("the end"):
            if self.thinned:
                self._log.note(f"the log was too slow for the run: {self.thinned} scans were left out")
            self._log.close()

    @contextmanager
    def _failures_counted(self, what: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # a log that fails must not end the run it reports on
            self.failures += 1
            if self.first_failure is None:
                self.first_failure = f"{what}: {type(error).__name__}: {error}"

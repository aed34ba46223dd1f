"""Receive the pipeline's events and log them in a separate thread, so that logging never delays SLAM."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue
from types import TracebackType

import numpy as np

from ...events import (
    Event,
    Finished,
    GroundTruthReceived,
    KeyframeAdded,
    LoopDecided,
    Relocalised,
    ScanTracked,
    StateChanged,
    SuspectFound,
    WallsMerged,
    WallsRemoved,
)
from ...formatting import counted
from .viewer import ViewerServer

BUSY_EVENTS = 500  # events in the queue, about a second of work; beyond, scans are left out
STALLED_EVENTS = (
    5_000  # events in the queue: logging has stalled, e.g. on a full disk; beyond, only rare events are kept
)
STALLED_SECONDS = 10.0  # without a logged event: logging has stalled, and a recording does not wait for it either
WAIT = 0.005  # seconds between two looks at the queue
RARE_EVENTS = (LoopDecided, WallsMerged, WallsRemoved, StateChanged, Relocalised, SuspectFound, Finished)
"""Events that are never left out: so rare that those of a whole day fit into the queue."""

_logger = logging.getLogger(__name__)


class ReviewLog:
    """A sink that writes the pipeline's events to a Rerun recording without delaying a live run.

    If logging cannot keep up with a recording, the pipeline waits for it (`complete`). In a live run, scan points and
    the robot's motion between keyframes are left out and counted then; if logging stalls, also keyframes, maps and
    notices, but never loop decisions. Errors while logging do not reach the pipeline; `close` reports them once.

    path        .rrd file to write; an existing one is overwritten. Long logs continue in further files beside it
    config      settings as TOML, shown beside the map
    recording   name of the mapped recording, under which the viewer lists the log
    versions    package names and their versions
    server      address at which viewers can connect at any time
    seed        of the simulation, if there is one
    part_size   bytes after which another file is started
    complete    for recordings: let the pipeline wait while logging is busy, at most STALLED_SECONDS at a time, and let
                rows wait for others to be written together with, MAX_RECORDED_AGE
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
        complete: bool = False,
    ) -> None:
        """Open the log. Raises OutputError if `path` cannot be written."""
        # Rerun is imported only if a log is wanted.
        from .event_log import EventLog
        from .rrd_writer import FLUSH_PERIOD, MAX_RECORDED_AGE, PART_SIZE

        self.path = path
        self.thinned = 0  # events left out, or logged without points, while the log was busy
        self.lost = 0  # events lost while the log was stalled
        self.unwritten = 0  # events after the file ended because the disk was nearly full
        self.failures = 0  # events that could not be logged
        self.first_failure: str | None = None
        self._queue: SimpleQueue[Event | None] = SimpleQueue()
        self._closed, self._complete, self._idle_time = False, complete, FLUSH_PERIOD
        size = PART_SIZE if part_size is None else part_size
        max_age = MAX_RECORDED_AGE if complete else FLUSH_PERIOD
        self._log = EventLog(path, config, recording, versions or {}, server, size, seed, max_age)
        self._worker = threading.Thread(target=self._work, name="review log", daemon=True)
        self._worker.start()

    def left_out(self) -> dict[str, int]:
        """Return the numbers of events that are not logged completely, by reason."""
        return {"thinned": self.thinned, "lost": self.lost, "failed": self.failures, "unwritten": self.unwritten}

    @property
    def waiting(self) -> int:
        """Number of events that are not logged yet."""
        return self._queue.qsize()

    def handle(self, event: Event) -> None:
        """Queue one event; takes microseconds unless `complete`. Events after `close` are ignored."""
        if self._closed:
            return
        if self._complete:
            self._wait_while_busy()
        waiting = self.waiting
        if waiting >= STALLED_EVENTS and not isinstance(event, RARE_EVENTS):
            self.lost += 1
            return
        if waiting >= BUSY_EVENTS:
            if isinstance(event, ScanTracked | GroundTruthReceived):
                self.thinned += 1
                return
            if isinstance(event, KeyframeAdded):
                self.thinned += 1
                event = replace(event, points=np.empty((0, 2)))
        self._queue.put(event)

    def _wait_while_busy(self) -> None:
        """Wait until logging has caught up; if it makes no progress at all, do not wait from then on."""
        waiting, since = self.waiting, time.monotonic()
        while self.waiting >= BUSY_EVENTS:
            if self.waiting < waiting:
                waiting, since = self.waiting, time.monotonic()
            elif time.monotonic() - since > STALLED_SECONDS:
                self._complete = False
                return
            time.sleep(WAIT)

    def close(self) -> None:
        """Log the queued events, finish the file and report errors. Closing again does nothing."""
        if self._closed:
            return
        self._closed = True
        self._queue.put(None)
        self._worker.join()
        reasons = []
        if self.failures:
            reasons.append(f"{counted(self.failures, 'event')} could not be logged (first: {self.first_failure})")
        if self.lost:
            reasons.append(f"{counted(self.lost, 'event')} left out because logging stalled")
        if reasons:
            # its folder can be a temporary one, which the run then renames
            _logger.error("%s is incomplete: %s", self.path.name, ", ".join(reasons))

    def __enter__(self) -> ReviewLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _work(self) -> None:
        while (event := self._next_event()) is not None:
            with self._failures_counted(type(event).__name__):
                self._log.write(event)
            self.unwritten += self._log.file_ended
        with self._failures_counted("closing"):
            if self.thinned:
                self._log.note(f"logging could not keep up: {self.thinned} scans were left out")
            self._log.close()

    def _next_event(self) -> Event | None:
        """Wait for the next event, and write what was logged before."""
        while True:
            try:
                return self._queue.get(timeout=self._idle_time)
            except Empty:
                with self._failures_counted("writing"):
                    self._log.write_waiting()

    @contextmanager
    def _failures_counted(self, what: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # an error in the log must not end the run
            self.failures += 1
            if self.first_failure is None:
                self.first_failure = f"{what}: {type(error).__name__}: {error}"

"""The reading process: a thread for each device, and threads that send and record the messages."""

from __future__ import annotations

import signal
import sys
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Event, Thread

from ..errors import DriverError, RecordingError
from ..messages import Message, Scan
from ..realtime import request_realtime_priority
from .device_spec import DeviceSpec
from .driving import BaseDriver, DriveCommand, DriveLimits
from .early_delivery import EarlyDelivery
from .outbox import Outbox
from .recorder import Recorder
from .reorder_buffer import ReorderBuffer
from .snapshot import Snapshot
from .supervisor import Supervisor

STATUS_PERIOD = 0.2
"""Seconds between two snapshots."""
POLL_PERIOD = 0.05
"""Seconds after which the processes check their state, whether or not anything has arrived."""
SWITCH_INTERVAL = 5e-4
"""Seconds for which a thread of the reading process, for example the recorder, may delay the others that read."""


@dataclass(frozen=True, slots=True)
class Job:
    """What the reading process does; for the fields see `Acquisition`."""

    specs: tuple[DeviceSpec, ...]
    recording: Path | None
    deliver: bool
    driving: DriveLimits | None
    in_order: bool


@dataclass(frozen=True, slots=True)
class PauseScans:
    """Item of the pipe to the reading process: leave out all scans from now on, or use them again."""

    paused: bool


@dataclass(frozen=True, slots=True)
class Failed:
    """Item of the pipe: the acquisition cannot start or continue."""

    reason: str


@dataclass(frozen=True, slots=True)
class Ended:
    """Item of the pipe: nothing more will arrive; all byte captures have ended, or the acquisition was stopped."""


class _DeviceReader:
    """The reading side: a thread for each device, its supervisor, and threads that send and record."""

    def __init__(self, pipe: Connection, job: Job, offset: float) -> None:
        self.stop = Event()
        specs = job.specs
        self._pipe, self._job, self._clock_offset = pipe, job, offset
        self._outbox = Outbox(pipe)
        self._recorder: Recorder | None = None
        self._unrecorded: list[Message] = []  # before all devices ran
        self._early = EarlyDelivery(self._outbox.put) if job.deliver and not job.in_order else None
        self._buffer = ReorderBuffer(len(specs), offset, early=self._early)
        self._paused = False
        lidars = [device for device, spec in enumerate(specs) if spec.is_lidar]
        self._lidar_numbers = {device: number for number, device in enumerate(lidars)}
        self._driver = None if job.driving is None else BaseDriver(job.driving)
        self._supervisors = [
            Supervisor(
                spec,
                partial(self._put, device),
                [other.address for other in specs if other is not spec],
                None if spec.is_lidar else self._driver,
                prompt=self._early is not None,
            )
            for device, spec in enumerate(specs)
        ]
        self._crash: BaseException | None = None

    def run(self) -> None:
        """Run until stopped, all supervisors have ended, or one has failed."""
        threads = [Thread(target=self._run_supervisor, args=(supervisor,)) for supervisor in self._supervisors]
        for thread in threads:
            thread.start()
        status_sent = 0.0
        try:
            while not self.stop.is_set() and any(thread.is_alive() for thread in threads):
                read = min(supervisor.read_until for supervisor in self._supervisors)
                for message in self._buffer.pop(read, POLL_PERIOD):
                    self._give_out(message)
                if time.monotonic() >= status_sent + STATUS_PERIOD:
                    status_sent = time.monotonic()
                    self._give_out_snapshot()
                if self._is_asked_to_stop() or self._outbox.broken:
                    break
                if any(supervisor.failure for supervisor in self._supervisors) or self._crash:
                    break
        finally:
            self.stop.set()
            for thread in threads:
                thread.join()
            for message in self._buffer.flush():
                self._give_out(message)
            if self._recorder is not None:
                self._recorder.put_snapshot(self._snapshot(), last=True)
                self._recorder.close()
        self._outbox.put_snapshot(self._snapshot())
        self._outbox.close()
        failure = self._crash or next(
            (supervisor.failure for supervisor in self._supervisors if supervisor.failure), None
        )
        self._pipe.send(Failed(str(failure)) if failure else Ended())

    def _is_asked_to_stop(self) -> bool:
        """Execute the requests of the consumer; return True on that to stop."""
        while self._pipe.poll():
            request: DriveCommand | PauseScans | None = self._pipe.recv()
            if request is None:
                return True
            if isinstance(request, PauseScans):
                self._paused = request.paused
            elif self._driver is not None:
                self._driver.put(request)
        return False

    def _put(self, device: int, messages: list[Message]) -> None:
        """Take messages of a device, in its thread; scans get the number of their lidar."""
        if number := self._lidar_numbers.get(device):
            messages = [
                replace(message, lidar=number) if isinstance(message, Scan) else message for message in messages
            ]
        if self._paused and any(isinstance(message, Scan) for message in messages):
            self._buffer.skip(device, messages)
            return
        self._buffer.put(device, messages)

    def _give_out(self, message: Message) -> None:
        """Record a message that is in order, and send it unless it was sent when it arrived."""
        if self._early is not None:
            self._early.ordered(message)
        elif self._job.deliver:
            self._outbox.put(message)
        if self._recorder is not None:
            self._recorder.put(message)
        elif self._job.recording is not None:
            self._unrecorded.append(message)

    def _give_out_snapshot(self) -> None:
        """Send and record the status; begin to record if all devices run."""
        snapshot = self._snapshot()
        if self._recorder is None and self._job.recording is not None and snapshot.all_have_run:
            try:
                self._recorder = Recorder(self._job.recording)
            except RecordingError as error:
                self._crash = error
                return
            for message in self._unrecorded:
                self._recorder.put(message)
            self._unrecorded.clear()
            snapshot = self._snapshot()
        self._outbox.put_snapshot(snapshot)
        if self._recorder is not None:
            self._recorder.put_snapshot(snapshot)

    def _run_supervisor(self, supervisor: Supervisor) -> None:
        try:
            supervisor.run(self.stop)
        except Exception as error:  # a bug: end the acquisition with an error instead of one thread silently
            place = traceback.extract_tb(error.__traceback__)[-1]
            what = f"{type(error).__name__} in {place.name}, line {place.lineno}: {error}"
            self._crash = DriverError(f"{supervisor.spec.text}: internal error: {what}")

    def _snapshot(self) -> Snapshot:
        statuses = tuple(supervisor.status() for supervisor in self._supervisors)
        recording = None if self._recorder is None else self._recorder.status
        dropped = self._buffer.dropped + self._outbox.dropped
        return Snapshot(statuses, dropped, self._buffer.late, recording, self._clock_offset)


def acquire(pipe: Connection, job: Job, offset: float) -> None:
    """Run the reading process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTSTP, signal.SIG_IGN)  # Ctrl-Z: the base must be stopped, and the recording go on
    sys.setswitchinterval(SWITCH_INTERVAL)
    request_realtime_priority()  # otherwise programs that keep all processors busy delay reads by tenths of a second
    reader = _DeviceReader(pipe, job, offset)
    signal.signal(signal.SIGTERM, lambda *_: reader.stop.set())
    with suppress(EOFError, OSError):  # the other process has ended
        reader.run()
    pipe.close()

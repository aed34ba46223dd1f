"""Devices read in a process of their own, so that a busy host neither delays nor loses a measurement.

    with Acquisition(parse_devices("rplidar:/dev/ttyUSB0 + create2:/dev/ttyUSB1")) as acquisition:
        for message in acquisition:
            ...

The processes are joined by a pipe. The reading process sends messages and, a few times a second, the status of its
devices. It halts all devices and ends on request, or when the pipe breaks because the other process has ended.
As always with multiprocessing, a program that uses this must be importable without side effects: `if __name__ ==
"__main__":`.
"""

from __future__ import annotations

import multiprocessing
import signal
import time
import traceback
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from threading import Event, Thread
from types import TracebackType
from typing import Self

from ..errors import DriverError
from ..messages import Message
from ..timestamps import wall_clock_offset
from .device_spec import DeviceSpec
from .reorder_buffer import ReorderBuffer
from .supervisor import DeviceStatus, Supervisor

STATUS_PERIOD = 0.2
"""Seconds between two snapshots."""
POLL_PERIOD = 0.05
"""Seconds after which the processes check their state, whether or not anything has arrived."""
HALT_TIMEOUT = 5.0
"""Seconds that halting may take before the process is killed; it covers the handshake of every device."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Status of the acquisition.

    devices  status of each device, in the order of the specs
    dropped  messages dropped for lack of room because the consumer was slow
    late     messages discarded because later ones had been delivered before they arrived
    """

    devices: tuple[DeviceStatus, ...] = ()
    dropped: int = 0
    late: int = 0


@dataclass(frozen=True, slots=True)
class _Failed:
    """Item of the pipe: the acquisition cannot start or continue."""

    reason: str


@dataclass(frozen=True, slots=True)
class _Ended:
    """Item of the pipe: nothing more will arrive; all byte captures have ended, or the acquisition was stopped."""


@dataclass(slots=True)
class Acquisition:
    """The consumer's side of the reading process; a context manager.

    Entering it waits until every device runs; raises DriverError if one does not.

    specs     of the devices
    snapshot  latest status received; it is updated while messages are received
    """

    specs: Sequence[DeviceSpec]
    snapshot: Snapshot = field(default_factory=Snapshot)
    _process: multiprocessing.process.BaseProcess | None = None
    _pipe: Connection | None = None
    _ended: bool = False
    _startup_messages: deque[Message] = field(default_factory=deque)  # received before all devices ran

    def __enter__(self) -> Self:
        context = multiprocessing.get_context("spawn")
        self._pipe, child_end = context.Pipe()
        self._process = context.Process(
            target=_acquire,
            args=(child_end, tuple(self.specs), wall_clock_offset()),
            name="wclm-acquisition",
            daemon=True,
        )
        # A terminal sends these signals to all its processes; this process forwards them to the reading one.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            child_end.close()
        try:
            while not self.snapshot.devices or not all(status.has_run for status in self.snapshot.devices):
                self._receive_status()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[Message]:
        """Yield messages in the order of their stamps, as they arrive, until the devices end or `stop` is called."""
        while not self.ended:
            message = self.receive(1.0)
            if message is not None:
                yield message

    def receive(self, timeout: float) -> Message | None:
        """Return the next message; None if none arrives within `timeout` seconds or the acquisition has ended."""
        if self._startup_messages:
            return self._startup_messages.popleft()
        end = time.monotonic() + timeout
        while not self._ended and self._poll_pipe(max(0.0, end - time.monotonic())):
            message = self._receive_item()
            if message is not None:
                return message
        return None

    @property
    def ended(self) -> bool:
        """True if no message is left and none will arrive."""
        return self._ended and not self._startup_messages

    def stop(self) -> None:
        """Halt all devices; messages measured so far can still be received."""
        if self._pipe is not None:
            with suppress(OSError):
                self._pipe.send(None)

    def close(self) -> None:
        """Halt all devices and wait for the process to end; messages not yet received are lost."""
        if self._process is None or self._pipe is None:
            return
        if not self._ended:
            self.stop()
        end = time.monotonic() + HALT_TIMEOUT
        with suppress(DriverError):
            while not self._ended and time.monotonic() < end:
                if self._poll_pipe(POLL_PERIOD):
                    self._receive_item()
        self._ended = True
        self._pipe.close()
        self._process.join(HALT_TIMEOUT if time.monotonic() < end else 0.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()
        self._process = self._pipe = None

    def _receive_status(self) -> None:
        if self._ended:
            raise DriverError("the devices were stopped before they started")
        if self._poll_pipe(1.0):
            before = self.snapshot
            while self.snapshot is before and not self._ended:
                message = self._receive_item()
                if message is not None:
                    self._startup_messages.append(message)

    def _poll_pipe(self, timeout: float) -> bool:
        assert self._pipe is not None
        return self._pipe.poll(timeout)

    def _receive_item(self) -> Message | None:
        """Receive one item from the pipe; return it if it is a message."""
        assert self._pipe is not None
        try:
            item = self._pipe.recv()
        except (EOFError, OSError):
            self._ended = True
            raise DriverError("the process that reads the devices ended unexpectedly") from None
        except BaseException:  # Ctrl-C within a message: the rest of the pipe cannot be decoded
            self._ended = True
            raise
        if isinstance(item, Snapshot):
            self.snapshot = item
        elif isinstance(item, _Ended):
            self._ended = True
        elif isinstance(item, _Failed):
            self._ended = True
            raise DriverError(item.reason)
        else:
            message: Message = item
            return message
        return None


class _DeviceReader:
    """The reading side: a supervisor and a thread for each device; this thread sends."""

    def __init__(self, pipe: Connection, specs: Sequence[DeviceSpec], offset: float) -> None:
        self.stop = Event()
        self._pipe = pipe
        self._buffer = ReorderBuffer(len(specs), offset)
        self._supervisors = [
            Supervisor(spec, partial(self._buffer.put, device), [other.address for other in specs if other is not spec])
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
                    self._pipe.send(message)
                if time.monotonic() >= status_sent + STATUS_PERIOD:
                    self._pipe.send(self._snapshot())
                    status_sent = time.monotonic()
                if self._pipe.poll():
                    self._pipe.recv()
                    break
                if any(supervisor.failure for supervisor in self._supervisors) or self._crash:
                    break
        finally:
            self.stop.set()
            for thread in threads:
                thread.join()
        for message in self._buffer.flush():
            self._pipe.send(message)
        self._pipe.send(self._snapshot())
        failure = self._crash or next(
            (supervisor.failure for supervisor in self._supervisors if supervisor.failure), None
        )
        self._pipe.send(_Failed(str(failure)) if failure else _Ended())

    def _run_supervisor(self, supervisor: Supervisor) -> None:
        try:
            supervisor.run(self.stop)
        except Exception as error:  # a bug: end the acquisition with an error instead of one thread silently
            place = traceback.extract_tb(error.__traceback__)[-1]
            what = f"{type(error).__name__} in {place.name}, line {place.lineno}: {error}"
            self._crash = DriverError(f"{supervisor.spec.text}: internal error: {what}")

    def _snapshot(self) -> Snapshot:
        statuses = tuple(supervisor.status() for supervisor in self._supervisors)
        return Snapshot(statuses, self._buffer.dropped, self._buffer.late)


def _acquire(pipe: Connection, specs: Sequence[DeviceSpec], offset: float) -> None:
    """Run the reading process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    reader = _DeviceReader(pipe, specs, offset)
    signal.signal(signal.SIGTERM, lambda *_: reader.stop.set())
    with suppress(EOFError, OSError):  # the other process has ended
        reader.run()
    pipe.close()

"""Devices read in a process of their own, so that a busy host neither delays nor loses a measurement.

    with Acquisition(parse_devices("rplidar:/dev/ttyUSB0 + create2:/dev/ttyUSB1")) as acquisition:
        for message in acquisition:
            ...

The processes are joined by a pipe. The reading process sends messages and, a few times a second, the status of its
devices. It also writes the recording, if there is one. It halts all devices and ends on request, or when the pipe
breaks because the other process has ended.
As always with multiprocessing, a program that uses this must be importable without side effects: `if __name__ ==
"__main__":`.
"""

from __future__ import annotations

import math
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from threading import RLock
from types import TracebackType
from typing import Self

from ..bases.interface import Velocity
from ..errors import DriverError
from ..messages import Message
from ..timestamps import wall_clock_offset
from .device_spec import DeviceSpec
from .driving import DriveCommand, DriveLimits, driven_base
from .reading_process import POLL_PERIOD, Ended, Failed, Job, PauseScans, acquire
from .snapshot import Snapshot
from .wheel_base import stop_base

HALT_TIMEOUT = 5.0
"""Seconds that halting may take before the process is killed; it covers the handshake of every device."""


@dataclass(slots=True)
class Acquisition:
    """The consumer's side of the reading process; a context manager.

    Entering it waits until every device runs; raises DriverError if one does not, or if exactly one wheel base is not
    given to drive.

    specs      of the devices
    recording  file to which all messages are written, replaced if it exists; None: no recording. It is created when
               every device runs. If it cannot be created, that is the DriverError of the acquisition
    deliver    False if no messages are wanted, only snapshots
    driving    limits of `drive`; None: no drive command is ever sent
    in_order   True to deliver messages in the order of their stamps; False as they arrive, up to one revolution
               earlier, for a consumer that needs no order, see `EarlyDelivery`. The recording is always in order
    snapshot   latest status received; it is updated while messages are received
    """

    specs: Sequence[DeviceSpec]
    recording: Path | None = None
    deliver: bool = True
    driving: DriveLimits | None = None
    in_order: bool = True
    snapshot: Snapshot = field(default_factory=Snapshot)
    _process: multiprocessing.process.BaseProcess | None = None
    _pipe: Connection | None = None
    _ended: bool = False
    _paused: bool = False
    _startup_messages: deque[Message] = field(default_factory=deque)  # received before all devices ran
    _sending: RLock = field(default_factory=RLock)  # a handler of a signal may stop what the same thread sends

    def __enter__(self) -> Self:
        if self.driving is not None:
            driven_base(self.specs)
        context = multiprocessing.get_context("spawn")
        job = Job(tuple(self.specs), self.recording, self.deliver, self.driving, self.in_order)
        self._pipe, child_end = context.Pipe()
        if self._paused:
            self._send(PauseScans(True))
        self._process = context.Process(
            target=acquire,
            args=(child_end, job, wall_clock_offset()),
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
            while not self.snapshot.all_have_run:
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

    def drive(self, speed: float, turn_rate: float) -> None:
        """Drive the base at a speed (m/s, forwards) and a turn rate (rad/s, counter-clockwise), within the limits.

        The base stops half a second after the last call, and at the end. May be called from any thread; calls before
        all devices run or after `stop` have no effect. Raises DriverError if driving was not requested or a value is
        not finite.
        """
        if self.driving is None:
            raise DriverError("the base is not driven: no limits of speed and turn rate were given")
        if not (math.isfinite(speed) and math.isfinite(turn_rate)):
            raise DriverError("a speed and a turn rate must be finite numbers")
        self._send(DriveCommand(Velocity(speed, turn_rate), time.monotonic()))

    def pause(self, paused: bool) -> None:
        """Leave out all scans from now on, also in the recording, or use them again.

        May be called from any thread, also before the devices are started.
        """
        self._paused = paused
        self._send(PauseScans(paused))

    def stop(self) -> None:
        """Halt all devices; messages measured so far can still be received."""
        self._send(None)

    def _send(self, request: DriveCommand | PauseScans | None) -> None:
        """Send a request to the reading process, unless that has ended."""
        with self._sending, suppress(OSError):
            if self._pipe is not None:
                self._pipe.send(request)

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
        self._end_process(HALT_TIMEOUT if time.monotonic() < end else 0.0)
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

    def _end_process(self, timeout: float) -> None:
        """Wait for the process to end, and kill it after `timeout` seconds."""
        assert self._process is not None
        self._process.join(timeout)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _stop_orphaned_base(self) -> str:
        """Stop the driven base, whose reading process was killed: not every base stops by itself then.

        The port is in use until that process has ended, which is later than the pipe breaks. Return what to add to the
        error if the base cannot be reached.
        """
        if self.driving is None or not self.snapshot.all_have_run:
            return ""
        self._end_process(HALT_TIMEOUT)
        (port,) = (device.port for device in self.snapshot.devices if not device.is_lidar)
        try:
            stop_base(driven_base(self.specs), port)
        except DriverError as error:
            return f", and the base could not be stopped: {error}"
        return ""

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
            raise DriverError(
                f"the process that reads the devices ended unexpectedly{self._stop_orphaned_base()}"
            ) from None
        except BaseException:  # Ctrl-C within a message: the rest of the pipe cannot be decoded
            self._ended = True
            raise
        if isinstance(item, Snapshot):
            self.snapshot = item
        elif isinstance(item, Ended):
            self._ended = True
        elif isinstance(item, Failed):
            self._ended = True
            raise DriverError(item.reason)
        else:
            message: Message = item
            return message
        return None

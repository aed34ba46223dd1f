"""Supervisor: runs one device. It finds, identifies, starts and reads the device, reconnects when it is silent, and
halts it at the end.

CONNECTING -> STARTING -> RUNNING -> LOST -> CONNECTING ...; -> ENDED
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from enum import Enum
from threading import Event, Lock

from ..errors import DriverError, EndOfCaptureError, NoResponseError, RecordingError, SlamError
from ..messages import Message, end_stamp
from ..transport import Transport
from .device import PROMPT_READ_PAUSE, READ_PAUSE, Device
from .device_spec import AUTO, CAPTURE_PREFIX, DeviceSpec
from .driving import BaseDriver
from .ports import candidate_addresses, connect, permanent_names
from .registry import make_device

SILENCE_TIMEOUT = 1.0
"""Seconds without an undamaged packet after which a running device is started again."""
MAX_READ_GAP = 1.5
"""Seconds between two reads. After a longer gap the age of the buffered bytes is unknown: buffers have overflowed, and
the clock fits are wrong.
"""
RETRY_PAUSES = (0.1, 0.3, 1.0, 2.0)
"""Seconds between attempts to find a lost device; the last one is repeated."""

NORMAL_COUNTERS = frozenset(
    {"messages", "bytes_read", "connections", "packets", "samples", "revolutions", "stray_points", "good", "readings"}
)
"""Counters of normal operation; all others count faults."""

SEARCH_LOCK = Lock()
"""Held while a device is searched on ports that the user did not name: two simultaneous searches would disturb each
other.
"""


class DeviceState(Enum):
    """State of a device."""

    CONNECTING = "connecting"
    STARTING = "starting"
    RUNNING = "running"
    LOST = "lost"
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class DeviceStatus:
    """Status of a device.

    spec      as typed by the user
    is_lidar  True for a lidar, False for a wheel base
    state     see `DeviceState`
    port      port on which it was found; empty before
    identity  description by the device itself; empty before it was identified
    problem   reason of its last loss; empty if it was never lost
    age       seconds since its last message was measured; None before the first one
    counters  all counts, see `Supervisor.status`
    """

    spec: str
    is_lidar: bool
    state: DeviceState
    port: str = ""
    identity: str = ""
    problem: str = ""
    age: float | None = None
    counters: dict[str, int] = field(default_factory=dict)

    @property
    def has_run(self) -> bool:
        """True if the device has measured anything so far."""
        return self.counters["connections"] > 0


def fault_counters(counters: Mapping[str, int]) -> dict[str, int]:
    """Return the non-zero counters of faults; see `NORMAL_COUNTERS`."""
    return {name: count for name, count in counters.items() if count and name not in NORMAL_COUNTERS}


class SilenceError(DriverError):
    """A connected device sends no usable data."""


class Supervisor:
    """Control of one device, in the thread that calls `run`.

    spec             of the device
    put              receives its messages, stamped on the host's steady clock
    other_addresses  addresses of other devices, at which this one is never searched
    driver           commands to the device, if it is a wheel base that is driven
    prompt           True if messages are needed promptly, for which the port is read more often

    failure  error of the first start, if it failed: the requested device is not there. A device that has run once is
             searched until it is back. If a byte capture is played, also the error of reading it
    """

    def __init__(
        self,
        spec: DeviceSpec,
        put: Callable[[list[Message]], None],
        other_addresses: Collection[str] = (),
        driver: BaseDriver | None = None,
        prompt: bool = False,
    ) -> None:
        self.spec = spec
        self._other_addresses = other_addresses
        self.failure: SlamError | None = None
        self.state = DeviceState.CONNECTING
        self._put = put
        self._is_played = spec.address.startswith(CAPTURE_PREFIX)
        self._device: Device = make_device(spec, driver)
        self._device.read_pause = PROMPT_READ_PAUSE if prompt else READ_PAUSE
        self._last_location: tuple[str, int] | None = None  # address and baud rate of the last connection
        self._names: list[str] = []  # permanent names of the port at the first connection
        self._was_connected = self._has_run = False
        self._problem = ""
        self._last_message_end: float | None = None  # end of the last message
        self._read_until = math.inf  # time of the last read; infinite while it is not connected
        self._counts = {
            "messages": 0,
            "bytes_read": 0,
            "connections": 0,
            "losses": 0,
            "silences": 0,
            "useless": 0,
            "pauses": 0,
        }

    def run(self, stop: Event) -> None:
        """Run until `stop` is set, the byte capture ends, or the first start fails; always halt the device."""
        attempts = 0
        while not stop.is_set():
            runs = self._counts["connections"]
            try:
                self.state = DeviceState.LOST if self._has_run else DeviceState.CONNECTING
                self._run_connected(self._find_device(stop), stop)
            except EndOfCaptureError:
                break
            except RecordingError as error:  # of a capture that is played: it cannot be read any further
                self.failure = error
                break
            except DriverError as error:
                if stop.is_set():
                    break
                if not self._has_run:
                    self.failure = error
                    break
                self._problem = str(error)
                lost_now = self._counts["connections"] > runs
                self._counts["losses"] += lost_now
                self.state = DeviceState.LOST
                attempts = 0 if lost_now else attempts + 1
                stop.wait(RETRY_PAUSES[min(attempts, len(RETRY_PAUSES) - 1)])
        self.state = DeviceState.ENDED

    @property
    def read_until(self) -> float:
        """Time of the last read whose messages have all been put (seconds on the steady clock); infinite while the
        device is not connected, as there is nothing to wait for.
        """
        return self._read_until

    def status(self) -> DeviceStatus:
        """Return the current status.

        The supervisor adds to the device's counters: messages, bytes_read, connections made, losses of a connection,
        and of these losses silences (the port is still there), useless (its measurements made up no message) and
        pauses (the computer was held up).
        """
        age = None if self._last_message_end is None else time.monotonic() - self._last_message_end
        port = "" if self._last_location is None else self._last_location[0]
        counters = self._counts | self._device.counters()
        return DeviceStatus(
            self.spec.text, self.spec.is_lidar, self.state, port, self._device.identity, self._problem, age, counters
        )

    def _find_device(self, stop: Event) -> Transport:
        """Find and start the device; raises the DriverError of the first address tried."""
        with SEARCH_LOCK if self.spec.address == AUTO else nullcontext():
            return self._try_ports(stop)

    def _try_ports(self, stop: Event) -> Transport:
        first: DriverError | None = None
        for address in candidate_addresses(self.spec, self._names, self._other_addresses):
            for baud in self._bauds(address):
                if stop.is_set():
                    break
                try:
                    return self._start(address, baud)
                except NoResponseError as error:  # perhaps at another baud rate
                    first = first or error
                except DriverError as error:
                    first = first or error
                    break
        problem = "no serial port found" if self.spec.address == AUTO else "its adapter is not plugged in"
        raise first or DriverError(f"{self.spec.text}: {problem}")

    def _bauds(self, address: str) -> list[int]:
        known = [self._last_location[1]] if self._last_location is not None else []
        single = self.spec.tcp is not None or address.startswith(CAPTURE_PREFIX)
        bauds = known + [baud for baud in self._device.bauds if baud not in known]
        return bauds[:1] if single else bauds

    def _start(self, address: str, baud: int) -> Transport:
        transport = connect(self.spec, address, baud, self._device.dtr, self._was_connected)
        self._was_connected = True
        try:
            self._device.start(transport, baud)
        except BaseException:
            self._disconnect(transport)
            raise
        self._last_location = (address, baud)
        self._names = self._names or permanent_names(address)
        if self._device.serial:
            self._device.required_serial = self._device.serial
        return transport

    def _run_connected(self, transport: Transport, stop: Event) -> None:
        """Read until `stop` is set; raises SilenceError or ConnectionLostError.

        A byte capture in which the device was lost is played on: it would begin again if it were connected again.
        """
        try:
            device, started = self._device, time.monotonic()
            self._read_until = last_message = started
            self.state = DeviceState.STARTING
            measurement_count, last_data = device.measurement_count, None
            before: float | None = None  # time of the last read; a capture has the clock of another computer
            while not stop.is_set():
                received, messages = device.step(transport)
                if before is not None:
                    self._check_read_gap(transport, received.time - before)
                before = received.time
                self._counts["bytes_read"] += len(received.data)
                if device.measurement_count != measurement_count:
                    if last_data is None:
                        self._counts["connections"] += 1
                        self.state, self._has_run = DeviceState.RUNNING, True
                        last_message = time.monotonic()
                    measurement_count, last_data = device.measurement_count, received.time
                elif last_data is None and time.monotonic() > started + device.start_timeout:
                    raise NoResponseError(transport.name, f"{device.identity} sends no measurements")
                elif last_data is not None and received.time > last_data + SILENCE_TIMEOUT and not self._is_played:
                    self._counts["silences"] += 1
                    raise SilenceError(f"{transport.name}: no measurements for {SILENCE_TIMEOUT:g} s")
                if messages:
                    last_message = time.monotonic()
                elif time.monotonic() > last_message + device.start_timeout and not self._is_played:
                    self._counts["useless"] += 1
                    reason = "no whole turn; does its head turn?" if self.spec.is_lidar else "no odometry"
                    raise SilenceError(f"{transport.name}: {device.identity} measures, but {reason}")
                self._deliver(messages)
                self._read_until = received.time
        finally:
            self._read_until = math.inf
            self._disconnect(transport)

    def _check_read_gap(self, transport: Transport, pause: float) -> None:
        """Check the time between two reads; raises SilenceError if this computer was held up for too long."""
        if pause > MAX_READ_GAP:
            self._counts["pauses"] += 1
            raise SilenceError(f"{transport.name}: not read for {pause:.1f} s because the computer was held up")

    def _deliver(self, messages: list[Message]) -> None:
        if messages:
            self._counts["messages"] += len(messages)
            self._last_message_end = end_stamp(messages[-1])
            self._put(messages)

    def _disconnect(self, transport: Transport) -> None:
        """Halt the device if it still responds, and close its port."""
        with suppress(DriverError):
            self._device.halt(transport)
        transport.close()

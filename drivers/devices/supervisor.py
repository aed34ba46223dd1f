"""The life of one device: found, identified, started, read, missed when it is silent, found again, halted at the end.

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

from ..errors import DriverError, EndOfCaptureError, NoResponseError
from ..messages import Message, end_stamp
from ..transport import Transport
from .device import Device
from .device_spec import AUTO, CAPTURE_PREFIX, DeviceSpec
from .ports import candidate_addresses, connect, searches_ports
from .registry import make_device

SILENCE_TIMEOUT = 1.0
"""Seconds without an undamaged packet after which a device that was running is started anew."""
MAX_READ_GAP = 1.5
"""Seconds between two reads after which what waited is of unknown age: buffers have overflowed, clocks lost track."""
RETRY_PAUSES = (0.1, 0.3, 1.0, 2.0)
"""Seconds between attempts to find a lost device; the last one is repeated."""

NORMAL_COUNTERS = frozenset(
    {"messages", "bytes_read", "connections", "packets", "samples", "revolutions", "good", "readings"}
)
"""Counters of what shall happen."""

SEARCH_LOCK = Lock()
"""Held while a device is looked for on ports that nobody named: two that look there at once find each other."""


class DeviceState(Enum):
    """Of a device."""

    CONNECTING = "connecting"
    STARTING = "starting"
    RUNNING = "running"
    LOST = "lost"
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class DeviceStatus:
    """How a device is doing.

    spec      as it was typed
    is_lidar  whether it is a lidar
    state     see `State`
    port      where it was found; empty before
    identity  what it says that it is; empty before it was identified
    problem   why it was lost last; empty if it never was
    age       seconds since its last message was measured; None before the first one
    counters  all counts, see `Session.status`
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
        """Whether it has measured anything so far."""
        return self.counters["connections"] > 0


def fault_counters(counters: Mapping[str, int]) -> dict[str, int]:
    """Those of a device's counters that count what went wrong, where anything did; see `ORDINARY`."""
    return {name: count for name, count in counters.items() if count and name not in NORMAL_COUNTERS}


class SilenceError(DriverError):
    """A device that is connected sends nothing that can be used."""


class Supervisor:
    """Runs a device in the thread that calls `run`.

    spec    what was asked for
    put     takes its messages, stamped on the host's steady clock
    others  addresses of other devices, where this one is never looked for

    failure  why the device could never be started, if so: what the user asked for is not there. A device that ran once
             is looked for until it is back
    """

    def __init__(
        self, spec: DeviceSpec, put: Callable[[list[Message]], None], other_addresses: Collection[str] = ()
    ) -> None:
        self.spec = spec
        self._other_addresses = other_addresses
        self.failure: DriverError | None = None
        self.state = DeviceState.CONNECTING
        self._put = put
        self._device: Device = make_device(spec)
        self._last_location: tuple[str, int] | None = None  # address and baud where it was last
        self._was_connected = self._has_run = False
        self._problem = ""
        self._last_message_end: float | None = None  # end of the last message
        self._read_until = math.inf  # when it was read last; infinite while it is not connected
        self._counts = {"messages": 0, "bytes_read": 0, "connections": 0, "losses": 0, "silences": 0, "pauses": 0}

    def run(self, stop: Event) -> None:
        """Until `stop` is set, the tape ends, or the first start fails; the device is halted in any case."""
        attempts = 0
        while not stop.is_set():
            runs = self._counts["connections"]
            try:
                self.state = DeviceState.LOST if self._has_run else DeviceState.CONNECTING
                self._run_connected(self._find_device(stop), stop)
            except EndOfCaptureError:
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
        """When the device was read last, all of which has been put (seconds on the steady clock); infinite where it is
        not connected, so that there is nothing to wait for.
        """
        return self._read_until

    def status(self) -> DeviceStatus:
        """How it is doing now. To the device's own counters come: messages, bytes_read, connections made, losses of a
        connection; of these silences, without the port being gone, and pauses, for which this computer is to blame.
        """
        age = None if self._last_message_end is None else time.monotonic() - self._last_message_end
        port = "" if self._last_location is None else self._last_location[0]
        counters = self._counts | self._device.counters()
        return DeviceStatus(
            self.spec.text, self.spec.is_lidar, self.state, port, self._device.identity, self._problem, age, counters
        )

    def _find_device(self, stop: Event) -> Transport:
        """The started device, wherever it is; raises the DriverError of the first place that was tried."""
        moved = self._has_run and bool(self._device.serial)
        with SEARCH_LOCK if searches_ports(self.spec, moved) else nullcontext():
            return self._try_ports(moved, stop)

    def _try_ports(self, moved: bool, stop: Event) -> Transport:
        first: DriverError | None = None
        for address in candidate_addresses(self.spec, moved, self._other_addresses):
            for baud in self._bauds(address):
                if stop.is_set():
                    break
                try:
                    return self._start(address, baud)
                except NoResponseError as error:  # perhaps at another speed
                    first = first or error
                except DriverError as error:
                    first = first or error
                    break
        text = f"{self.spec.text}: no serial port is there" if self.spec.address == AUTO else "stopped"
        raise first or DriverError(text)

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
        if self._device.serial:
            self._device.required_serial = self._device.serial
        return transport

    def _run_connected(self, transport: Transport, stop: Event) -> None:
        """Read until told to stop; raises SilenceError or ConnectionLostError."""
        try:
            device, started = self._device, time.monotonic()
            self._read_until = started
            self.state = DeviceState.STARTING
            measurement_count, last_data, before = device.measurement_count, None, started
            while not stop.is_set():
                received, messages = device.step(transport)
                self._check_read_gap(transport, received.time - before)
                before = received.time
                self._counts["bytes_read"] += len(received.data)
                if device.measurement_count != measurement_count:
                    if last_data is None:
                        self._counts["connections"] += 1
                        self.state, self._has_run = DeviceState.RUNNING, True
                    measurement_count, last_data = device.measurement_count, received.time
                elif last_data is None and time.monotonic() > started + device.start_timeout:
                    raise NoResponseError(transport.name, f"{device.identity} sends no measurements")
                elif last_data is not None and received.time > last_data + SILENCE_TIMEOUT:
                    self._counts["silences"] += 1
                    raise SilenceError(f"{transport.name}: no measurements for {SILENCE_TIMEOUT:g} s")
                self._deliver(messages)
                self._read_until = received.time
        finally:
            self._read_until = math.inf
            self._disconnect(transport)

    def _check_read_gap(self, transport: Transport, pause: float) -> None:
        """Raises SilenceError where this computer was held up for too long."""
        if pause > MAX_READ_GAP:
            self._counts["pauses"] += 1
            raise SilenceError(f"{transport.name}: not read for {pause:.1f} s, the computer was held up")

    def _deliver(self, messages: list[Message]) -> None:
        if messages:
            self._counts["messages"] += len(messages)
            self._last_message_end = end_stamp(messages[-1])
            self._put(messages)

    def _disconnect(self, transport: Transport) -> None:
        """Halt the device, if it still listens, and give its port back."""
        with suppress(DriverError):
            self._device.halt(transport)
        transport.close()

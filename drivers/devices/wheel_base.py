"""Wheel bases of all protocols: from readings to odometry."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from math import inf, pi
from typing import Any, NamedTuple

import numpy as np

from ..bases import (
    ArduinoBridge,
    Create2,
    DifferentialDrive,
    Kobuki,
    Odometer,
    WheelBase,
    WheelLine,
    create2,
    kobuki,
)
from ..errors import NoResponseError
from ..messages import Message
from ..transport import Received, Transport
from .device import READ_TIMEOUT, Device
from .device_spec import DeviceSpec
from .driving import STOPPED, BaseDriver
from .packet_stamper import MonotonicStamps
from .ports import connect
from .reading_stamper import ReadingStamper

REQUEST_RETRY_PERIOD = 1.0
"""Seconds after which the start request is repeated to a base that has not sent a reading yet: boards restart when a
port is opened, and miss requests sent meanwhile.
"""
WAKE_PULSE = 1.0
"""Seconds, an example of the manual of Create 2: three pulses shorter than half a second would change the baud rate."""
POLL_TIMEOUT = 0.2
"""Seconds; a polled base responds within some milliseconds."""
DEFAULT_TOP_SPEED = 1.5
"""m/s of a wheel of an unknown base: no small robot drives as fast."""
DEFAULT_COUNTER_BITS = 32


class BaseKind(NamedTuple):
    """A kind of wheel base.

    name      for display
    protocol  creates the host's side of the protocol
    drive     wheel geometry; None if it is the builder's
    dtr       state of the modem line DTR
    sleeps    True if a pulse on the modem line RTS wakes the base
    wheel_radius  metres, of `drive`
    """

    name: str
    protocol: Callable[[DifferentialDrive], WheelBase]
    drive: DifferentialDrive | None
    dtr: bool
    sleeps: bool = False
    wheel_radius: float = 1.0


BASE_KINDS: Mapping[str, BaseKind] = {
    "create2": BaseKind(
        "iRobot Create 2 or Roomba", Create2, create2.WHEELS, dtr=False, sleeps=True, wheel_radius=create2.WHEEL_RADIUS
    ),
    "kobuki": BaseKind("Kobuki", Kobuki, kobuki.WHEELS, dtr=False, wheel_radius=kobuki.WHEEL_RADIUS),
    "arduino": BaseKind("ros_arduino_bridge", ArduinoBridge, None, dtr=True),
    "wheels": BaseKind("base with the project's own line protocol", WheelLine, None, dtr=True),
}
"""Kinds of wheel bases by the name that a user types."""
PROBE_ORDER = ("kobuki", "wheels", "create2", "arduino")
"""Kinds in the order in which an unknown device is probed; the first two send readings without a request."""


def drive_geometry(kind: str, options: Mapping[str, Any]) -> DifferentialDrive:
    """Return the wheel geometry of a kind of base with the options of a device spec.

    Of the radius and the ticks, the one that the options lack is that of the kind.
    """
    drive = BASE_KINDS[kind].drive or DifferentialDrive(1.0, 1.0, 1.0, DEFAULT_COUNTER_BITS, DEFAULT_TOP_SPEED)
    if "wheel_radius" in options or "ticks" in options:
        radius = BASE_KINDS[kind].wheel_radius
        left, right = options.get("wheel_radius", (radius, radius))
        usual_ticks = 2 * pi * radius / drive.left, 2 * pi * radius / drive.right
        left_ticks, right_ticks = options.get("ticks", usual_ticks)
        drive = replace(drive, left=2 * pi * left / left_ticks, right=2 * pi * right / right_ticks)
    changed = {key: options[key] for key in ("track", "top_speed", "bits") if key in options}
    return replace(drive, **changed)


def stop_base(spec: DeviceSpec, address: str) -> None:
    """Stop the wheels of a base that no process reads any more; raises DriverError if its port cannot be opened."""
    device = WheelBaseDevice(spec.kind, spec.options)
    protocol = BASE_KINDS[spec.kind].protocol(drive_geometry(spec.kind, spec.options))
    transport = connect(spec, address, device.bauds[0], device.dtr, append=True)
    try:
        transport.write(protocol.enable_driving() + protocol.drive(STOPPED))
    finally:
        transport.close()


class WheelBaseDevice(Device):
    """A wheel base. The pose continues over new connections.

    driver  velocities to drive; None: no drive command is ever sent
    """

    start_timeout = 6.0

    def __init__(self, kind: str, options: Mapping[str, Any], driver: BaseDriver | None = None) -> None:
        super().__init__()
        self._kind, self._driver = BASE_KINDS[kind], driver
        self._wheels = drive_geometry(kind, options)
        self._odometer = Odometer(self._wheels)
        self._monotonic = MonotonicStamps()
        self._protocol = self._kind.protocol(self._wheels)
        self._previous_counts: Counter[str] = Counter()  # counts of earlier connections
        self._stamper: ReadingStamper
        self._requested_at: float
        self._last_reading: float  # time of the last reading of this connection
        self._woken: bool  # on this connection
        self._unanswered: int  # polls of this connection
        self.dtr = options.get("dtr", self._kind.dtr)
        self.bauds = (options.get("baud", self._protocol.baud),)
        self._reset_protocol(self.bauds[0])

    @property
    def measurement_count(self) -> int:
        """Undamaged readings."""
        return self._previous_counts["good"] + self._protocol.counters.good

    def identify(self, transport: Transport, baud: int) -> None:
        """Request a reading; raises NoResponseError if none arrives."""
        self.start(transport, baud)
        self._woken = True  # the pulse would restart some boards, and this may be another device
        end = time.monotonic() + self.start_timeout
        before = self.measurement_count
        while self.measurement_count == before:
            if time.monotonic() > end:
                raise NoResponseError(transport.name, f"no {self._kind.name} responds here")
            self.step(transport)
        self.halt(transport)

    def start(self, transport: Transport, baud: int) -> None:
        """Request readings; `step` repeats the request until they arrive. A base that was driven is stopped."""
        self._previous_counts += Counter(asdict(self._protocol.counters)) + Counter(self._stamper.counters())
        self._reset_protocol(baud)
        self.identity = self._kind.name
        transport.write(self._protocol.start())
        if self._driver is not None:
            transport.write(self._driver.restart(self._protocol))

    def step(self, transport: Transport) -> tuple[Received, list[Message]]:
        """Read once, or poll once and pause; send the drive command that is due."""
        if self._protocol.poll_period is not None:
            return self._poll(transport, self._protocol.poll_period)
        received, messages = super().step(transport)
        if self._protocol.counters.good == 0 and received.time > self._requested_at + REQUEST_RETRY_PERIOD:
            self._wake(transport)
            transport.write(self._protocol.start())
            self._requested_at = received.time
        self._drive(transport)
        return received, messages

    def feed(self, received: Received) -> list[Message]:
        """Return the odometry that the bytes complete."""
        readings = self._protocol.feed(received.data)
        self._last_reading = received.time if readings else self._last_reading
        ready = self._stamper.add(readings, len(received.data), received.time)
        stamps = self._monotonic.stamps(np.array([stamp for _, stamp in ready], dtype=float)).tolist()
        pairs = zip((reading for reading, _ in ready), stamps, strict=True)
        return [message for pair in pairs if (message := self._odometer.add(*pair))]

    def halt(self, transport: Transport) -> None:
        """Stop the wheels if the base was driven, and the readings if the protocol allows it."""
        if self._driver is not None:
            transport.write(self._driver.stop(self._protocol))
        transport.write(self._protocol.end())

    def counters(self) -> dict[str, int]:
        """Return the counts of the protocol, the odometer and the clock."""
        counts = self._previous_counts + Counter(asdict(self._protocol.counters)) + Counter(self._stamper.counters())
        names = ("good", "bad", "skipped", "lost", "restarts", "clock_jumps", "clock_strays")
        return {name: counts[name] for name in names} | asdict(self._odometer.counters)

    def _reset_protocol(self, baud: int) -> None:
        """Create a new protocol and stamper for a new connection."""
        self._protocol = self._kind.protocol(self._wheels)
        self._stamper = ReadingStamper(self._protocol, baud)
        self._requested_at = time.monotonic()
        self._last_reading = -inf
        self._woken = False
        self._unanswered = 0

    def _wake(self, transport: Transport) -> None:
        """Wake the base, once on each connection. USB cables for Create 2 connect RTS with its wake-up pin, BRC."""
        if self._kind.sleeps and not self._woken:
            self._woken = True
            transport.pulse_rts(WAKE_PULSE)

    def _drive(self, transport: Transport) -> None:
        if self._driver is not None:
            transport.write(self._driver.output(self._protocol, time.monotonic(), self._last_reading))

    def _poll(self, transport: Transport, period: float) -> tuple[Received, list[Message]]:
        """Poll one reading, stamped in the middle between request and response, and pause until the next one is due.

        A response that comes after POLL_TIMEOUT must not be taken for that to the next poll: all later ones would have
        the time of the poll after theirs. So a reading counts only if no poll is unanswered. If a response is lost, the
        next poll waits for one more in vain: then none is on its way.
        """
        requested_at = time.monotonic()
        transport.write(self._protocol.poll())
        self._unanswered += 1
        messages: list[Message] = []
        answers = 0
        while True:
            received = transport.read(READ_TIMEOUT)
            readings = self._protocol.feed(received.data)
            answers += len(readings)
            if readings and answers >= self._unanswered:
                self._unanswered = 0
                message = self._odometer.add(readings[-1], (requested_at + received.time) / 2)
                messages = [message] if message else []
                self._last_reading = received.time
                break
            if received.time > requested_at + POLL_TIMEOUT:
                self._unanswered = 0 if answers else 1
                break
        self._drive(transport)
        time.sleep(max(0.0, requested_at + period - time.monotonic()))
        return received, messages

"""Emulated wheel bases: the base's side of each protocol, with encoders, a clock and motors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from ..bases import ArduinoBridgeDevice, Create2Device, KobukiDevice, WheelLineDevice, create2, kobuki
from ..bases.arduino_bridge import ArduinoBridge
from ..bases.create2 import Create2
from ..bases.interface import Poll, Request, Reset, Stream, Velocity, WheelDevice, WheelReading
from ..bases.kinematics import DifferentialDrive
from ..bases.kobuki import Kobuki
from ..bases.wheel_line import WheelLine
from .device import EmulatedDevice
from .serial_line import SerialLine
from .wheel_sensors import Encoders, Gyro

ARDUINO_GEOMETRY = DifferentialDrive(left=1 / 5000, right=1 / 5000, track=0.30, bits=32, top_speed=0.6)
"""Default wheel geometry of the project's Arduino sketch."""
ARDUINO_BOOT_DURATION = 1.5
"""Seconds of an Arduino's boot loader."""
BATTERY_VOLTAGE = 16.4
"""Volts."""


@dataclass(frozen=True, slots=True)
class BaseVariant:
    """A wheel base.

    protocol    creates the base's side of the protocol
    wheels      wheel geometry as the makers state it
    baud        bits per second
    period      seconds between readings; None if it only responds
    tick        seconds per unit of its clock; None if it sends no time
    is_silent   True until it is requested to stream
    has_gyro    True if it has a gyro
    is_arduino  a board powered by USB that restarts when its port is opened
    deadman     seconds without a velocity command after which it stops
    """

    protocol: Callable[[DifferentialDrive], WheelDevice]
    wheels: DifferentialDrive
    baud: int
    period: float | None
    tick: float | None
    is_silent: bool = False
    has_gyro: bool = False
    is_arduino: bool = False
    deadman: float = math.inf


BASE_VARIANTS = {
    "create2": BaseVariant(Create2Device, create2.WHEELS, Create2.baud, Create2.tick, None, is_silent=True),
    "kobuki": BaseVariant(KobukiDevice, kobuki.WHEELS, Kobuki.baud, 0.02, Kobuki.tick, has_gyro=True),
    "arduino": BaseVariant(
        ArduinoBridgeDevice, ARDUINO_GEOMETRY, ArduinoBridge.baud, None, None, is_arduino=True, deadman=2.0
    ),
    "wheels": BaseVariant(
        lambda _: WheelLineDevice(),
        ARDUINO_GEOMETRY,
        WheelLine.baud,
        0.02,
        WheelLine.tick,
        is_arduino=True,
        deadman=0.5,
    ),
}
"""Wheel bases by the name that a user gives."""


class EmulatedWheelBase(EmulatedDevice):
    """One of BASE_VARIANTS.

    on_velocity  called with the velocities to drive
    """

    def __init__(
        self,
        name: str,
        line: SerialLine,
        drift: float,
        kind: BaseVariant,
        encoders: Encoders,
        has_gyro: Gyro,
        on_velocity: Callable[[Velocity], None],
    ) -> None:
        super().__init__(name, line, drift, usb_powered=kind.is_arduino)
        self.kind, self.encoders = kind, encoders
        self._gyro, self._on_velocity = has_gyro, on_velocity
        self._protocol = kind.protocol(kind.wheels)
        self._unrecognised_before = 0  # before the last restart of the board
        self._streaming = False
        self._next = 0  # number of the next reading
        self._commanded: float | None = None  # time of the last velocity command
        self.readings = self.velocities = 0

    def switch_on(self, time: float) -> None:
        """Start; counts begin at zero again."""
        super().switch_on(time)
        self._unrecognised_before = self.unrecognised
        self._protocol = self.kind.protocol(self.kind.wheels)
        self.encoders.reset(time)
        self._streaming = not self.kind.is_silent
        self._next = 0
        self._stop()

    def switch_off(self) -> None:
        """Stop, without power."""
        super().switch_off()
        self._stop()

    def on_port_opened(self, time: float) -> None:
        """Restart Arduinos: opening the port asserts the modem line DTR, which resets them."""
        if self.kind.is_arduino and self.on:
            self.line.clear(time)
            self.switch_on(time)

    @property
    def _ready(self) -> float:
        """Device time from which on it works."""
        return ARDUINO_BOOT_DURATION if self.kind.is_arduino else 0.0

    @property
    def unrecognised(self) -> int:
        """Bytes that belonged to no request."""
        return self._unrecognised_before + self._protocol.counters.skipped

    def receive(self, data: bytes, time: float) -> None:
        """Execute the requests and respond; ignore them while booting."""
        if self.on and self.to_device_time(time) >= self._ready:
            for request in self._protocol.feed(data):
                self.requests += 1
                self._execute(request, time)

    def _execute(self, request: Request, time: float) -> None:
        match request:
            case Velocity():
                self.velocities += 1
                self._commanded = time
                self._on_velocity(request)
            case Poll():
                self._send_reading(time)
            case Reset():
                self.encoders.reset(time)
            case Stream(on) if self.kind.period is not None:
                if on and not self._streaming:
                    self._next = math.ceil((self.to_device_time(time) - self._ready) / self.kind.period)
                self._streaming = on

    def _stop(self) -> None:
        self._commanded = None
        self._on_velocity(Velocity(0.0, 0.0))

    @property
    def due(self) -> float:
        """Time of the next reading."""
        if not self.on or not self._streaming or self.kind.period is None:
            return math.inf
        return self.to_host_time(self._ready + self._next * self.kind.period)

    def advance(self, time: float) -> None:
        """Send the readings that are due; stop if no velocity command came for too long."""
        while time >= self.due:
            self._send_reading(self.due)
            self._next += 1
        if self._commanded is not None and time > self._commanded + self.kind.deadman:
            self._stop()

    def _send_reading(self, time: float) -> None:
        """Send the reading at a time."""
        left, right = self.encoders.read(time)
        clock = round(self.to_device_time(time) / self.kind.tick) if self.kind.tick else None
        heading = self._gyro.read(time) if self.kind.has_gyro else None
        self.line.send(self._protocol.encode(WheelReading(left, right, clock, heading, BATTERY_VOLTAGE)), time)
        self.readings += 1

    def report(self) -> dict[str, object]:
        """Return the numbers of readings sent and velocities received, and the biases of the wheels."""
        biases = self.encoders.biases
        return {
            "readings": self.readings,
            "velocities": self.velocities,
            "biases": {"left": biases.left, "right": biases.right, "wheelbase": biases.wheelbase},
        }

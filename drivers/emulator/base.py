"""Emulated wheel bases: the base's side of each protocol, with encoders, a clock and motors behind it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from ..bases import ArduinoBridgeDevice, Create2Device, KobukiDevice, WheelLineDevice, create2, kobuki
from ..bases.arduino_bridge import ArduinoBridge
from ..bases.create2 import Create2
from ..bases.kinematics import DifferentialDrive
from ..bases.kobuki import Kobuki
from ..bases.readings import Poll, Request, Reset, Stream, Velocity, WheelDevice, WheelReading
from ..bases.wheel_line import WheelLine
from .device import Device
from .line import Line
from .wheels import Encoders, Gyro

ARDUINO = DifferentialDrive(left=1 / 5000, right=1 / 5000, track=0.30, bits=32, top_speed=0.6)
"""The measures that the project's sketch for Arduinos begins with."""
ARDUINO_BOOT = 1.5
"""Seconds that an Arduino's boot loader takes."""
BATTERY = 16.4
"""Volts."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A base.

    protocol  makes its side of the protocol
    wheels    its measures as its makers state them
    baud      bits a second
    period    seconds between readings; None where it only answers
    tick      seconds a unit of its clock; None where it tells no time
    silent    until it is told to stream
    gyro      whether it has one
    arduino   a board that takes its power from USB, and starts again when its port is opened
    deadman   seconds after which it stops unless it is told to drive again
    """

    protocol: Callable[[DifferentialDrive], WheelDevice]
    wheels: DifferentialDrive
    baud: int
    period: float | None
    tick: float | None
    silent: bool = False
    gyro: bool = False
    arduino: bool = False
    deadman: float = math.inf


KINDS = {
    "create2": Kind(Create2Device, create2.WHEELS, Create2.baud, Create2.tick, None, silent=True),
    "kobuki": Kind(KobukiDevice, kobuki.WHEELS, Kobuki.baud, 0.02, Kobuki.tick, gyro=True),
    "arduino": Kind(ArduinoBridgeDevice, ARDUINO, ArduinoBridge.baud, None, None, arduino=True, deadman=2.0),
    "wheels": Kind(
        lambda _: WheelLineDevice(), ARDUINO, WheelLine.baud, 0.02, WheelLine.tick, arduino=True, deadman=0.5
    ),
}
"""By the name that a user gives."""


class Base(Device):
    """One of KINDS.

    obey  is called with the velocities that the base is to drive
    """

    def __init__(
        self,
        name: str,
        line: Line,
        drift: float,
        kind: Kind,
        encoders: Encoders,
        gyro: Gyro,
        obey: Callable[[Velocity], None],
    ) -> None:
        super().__init__(name, line, drift, usb_powered=kind.arduino)
        self.kind, self.encoders = kind, encoders
        self._gyro, self._obey = gyro, obey
        self._protocol = kind.protocol(kind.wheels)
        self._misheard = 0  # by boards that have started again since
        self._streaming = False
        self._next = 0  # number of the next reading
        self._commanded: float | None = None  # when it was last told to drive
        self.readings = self.velocities = 0

    def switch_on(self, time: float) -> None:
        """Start; counts begin at zero again."""
        super().switch_on(time)
        self._misheard = self.misheard
        self._protocol = self.kind.protocol(self.kind.wheels)
        self.encoders.reset(time)
        self._streaming = not self.kind.silent
        self._next = 0
        self._halt()

    def switch_off(self) -> None:
        """Stand, without power."""
        super().switch_off()
        self._halt()

    def port_opened(self, time: float) -> None:
        """The line DTR, which a program asserts when it opens the port, starts Arduinos again."""
        if self.kind.arduino and self.on:
            self.line.clear(time)
            self.switch_on(time)

    @property
    def _ready(self) -> float:
        """Own time from which on it works."""
        return ARDUINO_BOOT if self.kind.arduino else 0.0

    @property
    def misheard(self) -> int:
        """Bytes that belonged to no request."""
        return self._misheard + self._protocol.counters.skipped

    def hear(self, data: bytes, time: float) -> None:
        """Obey and answer; deaf while it boots."""
        if self.on and self.own(time) >= self._ready:
            for request in self._protocol.feed(data):
                self.requests += 1
                self._heed(request, time)

    def _heed(self, request: Request, time: float) -> None:
        match request:
            case Velocity():
                self.velocities += 1
                self._commanded = time
                self._obey(request)
            case Poll():
                self._tell(time)
            case Reset():
                self.encoders.reset(time)
            case Stream(on) if self.kind.period is not None:
                if on and not self._streaming:
                    self._next = math.ceil((self.own(time) - self._ready) / self.kind.period)
                self._streaming = on

    def _halt(self) -> None:
        self._commanded = None
        self._obey(Velocity(0.0, 0.0))

    @property
    def due(self) -> float:
        """When the next reading is."""
        if not self.on or not self._streaming or self.kind.period is None:
            return math.inf
        return self.host(self._ready + self._next * self.kind.period)

    def advance(self, time: float) -> None:
        """Send the readings that are due; stop where no command came for too long."""
        while time >= self.due:
            self._tell(self.due)
            self._next += 1
        if self._commanded is not None and time > self._commanded + self.kind.deadman:
            self._halt()

    def _tell(self, time: float) -> None:
        """Send the reading of a time."""
        left, right = self.encoders.read(time)
        clock = round(self.own(time) / self.kind.tick) if self.kind.tick else None
        heading = self._gyro.read(time) if self.kind.gyro else None
        self.line.send(self._protocol.encode(WheelReading(left, right, clock, heading, BATTERY)), time)
        self.readings += 1

    def report(self) -> dict[str, object]:
        """Readings sent, velocities heard, and what is wrong with the wheels."""
        biases = self.encoders.biases
        return {
            "readings": self.readings,
            "velocities": self.velocities,
            "biases": {"left": biases.left, "right": biases.right, "wheelbase": biases.wheelbase},
        }

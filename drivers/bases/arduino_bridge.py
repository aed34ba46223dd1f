r"""ros_arduino_bridge: lines of text without checksum or time; the base only answers.

`e\r` is answered with `<left> <right>\r\n`, counts of 32 bits; `r\r` sets them to zero; `m <left> <right>\r` drives so
many counts in each frame of the base's control loop, for two seconds. Opening the port restarts most boards: they take
a second or two to answer. The time of a reading is best taken in the middle of request and answer.
"""

from __future__ import annotations

import re
from typing import ClassVar

from .framing import Lines
from .interface import Counters, Poll, Request, Reset, Velocity, WheelReading, signed
from .kinematics import DifferentialDrive

CONTROL_RATE = 30
"""Frames a second of the base's control loop."""
LONGEST = 64
"""Bytes in a line; two counts take 23."""
READING = re.compile(rb"(-?[0-9]{1,10}) (-?[0-9]{1,10})\r")
MOTORS = re.compile(rb"m (-?[0-9]{1,5}) (-?[0-9]{1,5})")
ANSWERS = (b"OK\r", b"57600\r")
"""What other requests are answered with."""


class ArduinoBridge:
    """The host's side; see `WheelBase`. There is no usual drive: its measures are the builder's."""

    name: ClassVar[str] = "arduino_bridge"
    baud: ClassVar[int] = 57600
    tick: ClassVar[float | None] = None
    wraps_at: ClassVar[int | None] = None
    poll_period: ClassVar[float | None] = 0.02

    def __init__(self, wheels: DifferentialDrive) -> None:
        self.wheels, self.counters = wheels, Counters()
        self._lines = Lines(b"\n", LONGEST, self.counters)

    def start(self) -> bytes:
        """An end of line, which ends what another program may have left half said."""
        return b"\r"

    def poll(self) -> bytes:
        """Ask for the counts."""
        return b"e\r"

    def drive(self, velocity: Velocity) -> bytes:
        """The wheels' speeds in counts a frame."""
        left, right = self.wheels.wheel_speeds(velocity.speed, velocity.turn_rate)
        counts = (left / self.wheels.left / CONTROL_RATE, right / self.wheels.right / CONTROL_RATE)
        return b"m %d %d\r" % (round(counts[0]), round(counts[1]))

    def stop(self) -> bytes:
        """Stand."""
        return self.drive(Velocity(0.0, 0.0))

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """The readings that a chunk completes."""
        readings = []
        for line in self._lines.feed(chunk):
            counts = [int(count) for count in match.groups()] if (match := READING.fullmatch(line)) else []
            if counts and all(signed(count, 32) == count for count in counts):
                self.counters.good += 1
                readings.append(WheelReading(*counts))
            elif line not in ANSWERS:
                self.counters.bad += 1
                self.counters.skipped += len(line) + 1
        return readings


class ArduinoBridgeDevice:
    """The base's side; see `WheelDevice`."""

    def __init__(self, wheels: DifferentialDrive) -> None:
        self.counters = Counters()
        self._wheels = wheels
        self._lines = Lines(b"\r", LONGEST, self.counters)

    def encode(self, reading: WheelReading) -> bytes:
        """The answer to one poll."""
        return b"%d %d\r\n" % (signed(reading.left, 32), signed(reading.right, 32))

    def feed(self, chunk: bytes) -> list[Request]:
        """The requests that a chunk completes."""
        requests: list[Request] = []
        for line in self._lines.feed(chunk):
            if line == b"e":
                requests.append(Poll())
            elif line == b"r":
                requests.append(Reset())
            elif match := MOTORS.fullmatch(line):
                requests.append(self._velocity(*(int(count) for count in match.groups())))
            elif line:
                self.counters.bad += 1
                self.counters.skipped += len(line) + 1
                continue
            self.counters.good += bool(line)
        return requests

    def _velocity(self, left_counts: int, right_counts: int) -> Velocity:
        left, right = left_counts * CONTROL_RATE * self._wheels.left, right_counts * CONTROL_RATE * self._wheels.right
        return Velocity((left + right) / 2, (right - left) / self._wheels.track)

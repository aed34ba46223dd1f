r"""Protocol of ros_arduino_bridge: lines of text without checksum or time; the base only responds to requests.

The response to `e\r` is `<left> <right>\r\n`, counts of 32 bits; `r\r` sets them to zero; `m <left> <right>\r` drives
at this many counts per period of the base's control loop, for two seconds. Opening the port restarts most boards, which
takes a second or two. The best estimate of a reading's time is the middle between request and response.
"""

from __future__ import annotations

import re
from typing import ClassVar

from .framing import LineParser
from .interface import ParserCounters, Poll, Request, Reset, Velocity, WheelReading, to_signed
from .kinematics import DifferentialDrive

CONTROL_RATE = 30
"""Rate of the base's control loop, Hz."""
MAX_LINE_LENGTH = 64
"""Bytes; a reading has at most 23."""
READING = re.compile(rb"(-?[0-9]{1,10}) (-?[0-9]{1,10})\r")
MOTORS = re.compile(rb"m (-?[0-9]{1,5}) (-?[0-9]{1,5})")
OTHER_RESPONSES = (b"OK\r", b"57600\r")
"""Responses to other requests."""


class ArduinoBridge:
    """Host's side of the protocol, see `WheelBase`. The dimensions of the drive are those of the user's robot."""

    name: ClassVar[str] = "arduino_bridge"
    baud: ClassVar[int] = 57600
    tick: ClassVar[float | None] = None
    wraps_at: ClassVar[int | None] = None
    poll_period: ClassVar[float | None] = 0.02

    def __init__(self, wheels: DifferentialDrive) -> None:
        self.wheels, self.counters = wheels, ParserCounters()
        self._lines = LineParser(b"\n", MAX_LINE_LENGTH, self.counters)

    def start(self) -> bytes:
        """Return a line terminator, which completes a line that another program may have left unfinished."""
        return b"\r"

    def poll(self) -> bytes:
        """Return the request for the counts."""
        return b"e\r"

    def enable_driving(self) -> bytes:
        """Return nothing: the base always obeys drive commands."""
        return b""

    def drive(self, velocity: Velocity) -> bytes:
        """Return the command with the wheels' speeds in counts per control period."""
        left, right = self.wheels.wheel_speeds(velocity.speed, velocity.turn_rate)
        counts = (left / self.wheels.left / CONTROL_RATE, right / self.wheels.right / CONTROL_RATE)
        return b"m %d %d\r" % (round(counts[0]), round(counts[1]))

    def end(self) -> bytes:
        """Return nothing: the base sends on request only."""
        return b""

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """Return the readings that a chunk completes."""
        readings = []
        for line in self._lines.feed(chunk):
            counts = [int(count) for count in match.groups()] if (match := READING.fullmatch(line)) else []
            if counts and all(to_signed(count, 32) == count for count in counts):
                self.counters.good += 1
                readings.append(WheelReading(*counts))
            elif line not in OTHER_RESPONSES:
                self._lines.reject(line)
        return readings


class ArduinoBridgeDevice:
    """Device's side of the protocol, see `WheelDevice`."""

    def __init__(self, wheels: DifferentialDrive) -> None:
        self.counters = ParserCounters()
        self._wheels = wheels
        self._lines = LineParser(b"\r", MAX_LINE_LENGTH, self.counters)

    def encode(self, reading: WheelReading) -> bytes:
        """Return the response to one poll."""
        return b"%d %d\r\n" % (to_signed(reading.left, 32), to_signed(reading.right, 32))

    def feed(self, chunk: bytes) -> list[Request]:
        """Return the requests that a chunk completes."""
        requests: list[Request] = []
        for line in self._lines.feed(chunk):
            if line == b"e":
                requests.append(Poll())
            elif line == b"r":
                requests.append(Reset())
            elif match := MOTORS.fullmatch(line):
                requests.append(self._velocity(*(int(count) for count in match.groups())))
            elif line:
                self._lines.reject(line)
                continue
            self.counters.good += bool(line)
        return requests

    def _velocity(self, left_counts: int, right_counts: int) -> Velocity:
        left, right = left_counts * CONTROL_RATE * self._wheels.left, right_counts * CONTROL_RATE * self._wheels.right
        return Velocity((left + right) / 2, (right - left) / self._wheels.track)

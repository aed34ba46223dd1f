r"""This project's protocol for self-built wheel bases: lines of text with checksums.

The base sends 50 to 100 times per second, without requests,

    O,<sequence>,<microseconds>,<left>,<right>[,<millidegrees>]*HH\n

and accepts the drive command

    V,<mm/s>,<millirad/s>*HH\n

HH is the exclusive or of the characters before the asterisk, as two upper-case hexadecimal digits.
docs/wheel-protocol.md specifies the protocol, arduino/wheel_line/wheel_line.ino implements a base.
"""

from __future__ import annotations

import math
import re
from functools import reduce
from operator import xor
from typing import ClassVar

from ..se2 import wrap
from .framing import LineParser
from .interface import ParserCounters, Request, Velocity, WheelReading, to_signed
from .kinematics import DifferentialDrive

MAX_LINE_LENGTH = 80
"""Bytes; a reading has at most 54."""
READING = re.compile(rb"O,([0-9]{1,5}),([0-9]{1,10}),(-?[0-9]{1,10}),(-?[0-9]{1,10})(?:,(-?[0-9]{1,6}))?")
VELOCITY = re.compile(rb"V,(-?[0-9]{1,5}),(-?[0-9]{1,5})")
SEQUENCE_SIZE = 65536
MAX_LOST_READINGS = 1000
"""Readings, ten to twenty seconds; if more seem to be missing, the base has restarted."""


def add_checksum(text: bytes) -> bytes:
    """Return the line for a text: the text, its checksum and the terminator."""
    return b"%b*%02X\n" % (text, reduce(xor, text, 0))


def strip_checksum(line: bytes) -> bytes | None:
    """Return the text of a line without its checksum; None if the checksum is wrong. The terminator is not passed."""
    text = line[:-3]
    return text if add_checksum(text)[:-1] == line else None


class WheelLine:
    """Host's side of the protocol, see `WheelBase`. The dimensions of the drive are those of the user's robot."""

    name: ClassVar[str] = "wheel_line"
    baud: ClassVar[int] = 115200
    tick: ClassVar[float | None] = 1e-6
    wraps_at: ClassVar[int | None] = 1 << 32
    poll_period: ClassVar[float | None] = None

    def __init__(self, wheels: DifferentialDrive) -> None:
        self.wheels, self.counters = wheels, ParserCounters()
        self._lines = LineParser(b"\n", MAX_LINE_LENGTH, self.counters)
        self._sequence: int | None = None

    def start(self) -> bytes:
        """Return a line terminator, which completes a line that another program may have left unfinished."""
        return b"\n"

    def poll(self) -> bytes:
        """Return nothing: the base sends without requests."""
        return b""

    def enable_driving(self) -> bytes:
        """Return nothing: the base always obeys drive commands."""
        return b""

    def drive(self, velocity: Velocity) -> bytes:
        """Return the drive command, which is valid for half a second."""
        left, right = self.wheels.wheel_speeds(velocity.speed, velocity.turn_rate)
        speed, turn_rate = (right + left) / 2, (right - left) / self.wheels.track
        return add_checksum(b"V,%d,%d" % (round(1000 * speed), round(1000 * turn_rate)))

    def end(self) -> bytes:
        """Return nothing: the readings cannot be ended."""
        return b""

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """Return the readings that a chunk completes."""
        readings = []
        for line in self._lines.feed(chunk):
            numbers = _parse_reading(line)
            if numbers is None:
                self._lines.reject(line)
                continue
            sequence, time, left, right, *heading = numbers
            self._count_lost(sequence)
            gyro_heading = float(wrap(math.radians(heading[0] / 1000))) if heading else None
            readings.append(WheelReading(left, right, time, gyro_heading))
        return readings

    def _count_lost(self, sequence: int) -> None:
        self.counters.good += 1
        if self._sequence is not None:
            missing = (sequence - self._sequence - 1) % SEQUENCE_SIZE
            if missing > MAX_LOST_READINGS:
                self.counters.restarts += 1
            else:
                self.counters.lost += missing
        self._sequence = sequence


def _parse_reading(line: bytes) -> list[int] | None:
    """Return sequence, microseconds, both counts and, if present, the heading; None if the line is not a reading."""
    match = READING.fullmatch(strip_checksum(line) or b"")
    if match is None:
        return None
    sequence, time, left, right, *heading = [int(number) for number in match.groups() if number is not None]
    in_range = (
        sequence < SEQUENCE_SIZE and time < 1 << 32 and to_signed(left, 32) == left and to_signed(right, 32) == right
    )
    return [sequence, time, left, right, *heading] if in_range else None


class WheelLineDevice:
    """Device's side of the protocol, see `WheelDevice`."""

    def __init__(self) -> None:
        self.counters = ParserCounters()
        self._lines = LineParser(b"\n", MAX_LINE_LENGTH, self.counters)
        self._sequence = 0

    def encode(self, reading: WheelReading) -> bytes:
        """Return the next line."""
        time = (reading.time or 0) % (1 << 32)
        text = b"O,%d,%d,%d,%d" % (self._sequence, time, to_signed(reading.left, 32), to_signed(reading.right, 32))
        if reading.heading is not None:
            text += b",%d" % round(1000 * math.degrees(reading.heading))
        self._sequence = (self._sequence + 1) % SEQUENCE_SIZE
        return add_checksum(text)

    def feed(self, chunk: bytes) -> list[Request]:
        """Return the requests that a chunk completes."""
        requests: list[Request] = []
        for line in self._lines.feed(chunk):
            match = VELOCITY.fullmatch(strip_checksum(line) or b"")
            if match is not None:
                self.counters.good += 1
                speed, turn_rate = (int(number) / 1000 for number in match.groups())
                requests.append(Velocity(speed, turn_rate))
            elif line:
                self._lines.reject(line)
        return requests

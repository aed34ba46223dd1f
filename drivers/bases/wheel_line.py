r"""The project's own protocol for wheel bases of one's own making: lines of text with checksums.

The base sends, 50 to 100 times a second and without being asked,

    O,<sequence>,<microseconds>,<left>,<right>[,<millidegrees>]*HH\n

and is driven by

    V,<mm/s>,<millirad/s>*HH\n

HH is the exclusive or of the characters before the asterisk, as two upper-case hexadecimal digits.
docs/wheel-protocol.md has the details, arduino/wheel_line/wheel_line.ino is a base.
"""

from __future__ import annotations

import math
import re
from functools import reduce
from operator import xor
from typing import ClassVar

from ..se2 import wrap
from .framing import Lines
from .interface import Counters, Request, Velocity, WheelReading, signed
from .kinematics import DifferentialDrive

LONGEST = 80
"""Bytes in a line; the longest reading takes 54."""
READING = re.compile(rb"O,([0-9]{1,5}),([0-9]{1,10}),(-?[0-9]{1,10}),(-?[0-9]{1,10})(?:,(-?[0-9]{1,6}))?")
VELOCITY = re.compile(rb"V,(-?[0-9]{1,5}),(-?[0-9]{1,5})")
SEQUENCES = 65536
MANY = 1000
"""Readings, ten to twenty seconds; where more seem to be missing, the base has begun to count anew."""


def sealed(text: bytes) -> bytes:
    """A line: the text, its checksum and the end."""
    return b"%b*%02X\n" % (text, reduce(xor, text, 0))


def unsealed(line: bytes) -> bytes | None:
    """The text of a line without its end; None where the checksum is not the text's."""
    text = line[:-3]
    return text if sealed(text)[:-1] == line else None


class WheelLine:
    """The host's side; see `WheelBase`. There is no usual drive: its measures are the builder's."""

    name: ClassVar[str] = "wheel_line"
    baud: ClassVar[int] = 115200
    tick: ClassVar[float | None] = 1e-6
    wraps_at: ClassVar[int | None] = 1 << 32
    poll_period: ClassVar[float | None] = None

    def __init__(self, wheels: DifferentialDrive) -> None:
        self.wheels, self.counters = wheels, Counters()
        self._lines = Lines(b"\n", LONGEST, self.counters)
        self._sequence: int | None = None

    def start(self) -> bytes:
        """An end of line, which ends what another program may have left half said."""
        return b"\n"

    def poll(self) -> bytes:
        """Nothing: the base sends by itself."""
        return b""

    def drive(self, velocity: Velocity) -> bytes:
        """A command, obeyed for half a second."""
        left, right = self.wheels.wheel_speeds(velocity.speed, velocity.turn_rate)
        speed, turn_rate = (right + left) / 2, (right - left) / self.wheels.track
        return sealed(b"V,%d,%d" % (round(1000 * speed), round(1000 * turn_rate)))

    def stop(self) -> bytes:
        """Stand; the base cannot be silenced."""
        return self.drive(Velocity(0.0, 0.0))

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """The readings that a chunk completes."""
        readings = []
        for line in self._lines.feed(chunk):
            numbers = _numbers(line)
            if numbers is None:
                self.counters.bad += 1
                self.counters.skipped += len(line) + 1
                continue
            sequence, time, left, right, *heading = numbers
            self._count(sequence)
            turned = float(wrap(math.radians(heading[0] / 1000))) if heading else None
            readings.append(WheelReading(left, right, time, turned))
        return readings

    def _count(self, sequence: int) -> None:
        self.counters.good += 1
        if self._sequence is not None:
            missing = (sequence - self._sequence - 1) % SEQUENCES
            if missing > MANY:
                self.counters.restarts += 1
            else:
                self.counters.lost += missing
        self._sequence = sequence


def _numbers(line: bytes) -> list[int] | None:
    """The sequence, the microseconds, both counts and, where there is one, the heading; None where it is no reading."""
    match = READING.fullmatch(unsealed(line) or b"")
    if match is None:
        return None
    sequence, time, left, right, *heading = [int(number) for number in match.groups() if number is not None]
    in_range = sequence < SEQUENCES and time < 1 << 32 and signed(left, 32) == left and signed(right, 32) == right
    return [sequence, time, left, right, *heading] if in_range else None


class WheelLineDevice:
    """The base's side; see `WheelDevice`."""

    def __init__(self) -> None:
        self.counters = Counters()
        self._lines = Lines(b"\n", LONGEST, self.counters)
        self._sequence = 0

    def encode(self, reading: WheelReading) -> bytes:
        """The next line."""
        time = (reading.time or 0) % (1 << 32)
        text = b"O,%d,%d,%d,%d" % (self._sequence, time, signed(reading.left, 32), signed(reading.right, 32))
        if reading.heading is not None:
            text += b",%d" % round(1000 * math.degrees(reading.heading))
        self._sequence = (self._sequence + 1) % SEQUENCES
        return sealed(text)

    def feed(self, chunk: bytes) -> list[Request]:
        """The requests that a chunk completes."""
        requests: list[Request] = []
        for line in self._lines.feed(chunk):
            match = VELOCITY.fullmatch(unsealed(line) or b"")
            if match is not None:
                self.counters.good += 1
                speed, turn_rate = (int(number) / 1000 for number in match.groups())
                requests.append(Velocity(speed, turn_rate))
            elif line:
                self.counters.bad += 1
                self.counters.skipped += len(line) + 1
        return requests

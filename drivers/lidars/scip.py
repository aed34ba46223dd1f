"""Hokuyo's SCIP 2.0: lines of ASCII asked for and answered. This is the language; `scip_scan` reads its measurements.

A reply is the command's echo, a status with a checksum, lines each with a checksum, and an empty line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import DriverError
from .measurements import Bytes, Flags, Integers

OFFSET = 0x30
"""Characters 0x30 to 0x6F stand for six bits."""
LINE_LENGTH = 64
"""Characters of data in a line, before its checksum."""
MAX_LINE_LENGTH = 256
MAX_LINES = 256
"""In a reply; 1 921 steps of three characters, the most that a Hokuyo sends, take 91."""
OK = "00"
DATA = "99"
"""Status of the replies in which measurements keep coming."""

STOP = b"QT\n"
LASER_ON = b"BM\n"
PARAMETERS = b"PP\n"
VERSION = b"VV\n"
USE_SCIP2 = b"SCIP2.0\n"
"""To a device that answers `E` because it still speaks SCIP 1.1."""
CLOCK = b"TM1\n"


def checksum(text: bytes) -> bytes:
    """The character that follows `text`: the sum's lowest six bits."""
    return bytes([(sum(text) & 0x3F) + OFFSET])


def strip_checksum(line: bytes) -> bytes | None:
    """A line without its checksum; None where that is wrong.

    Lines of parameters have a semicolon before the checksum, which does not count.
    """
    text, told = line[:-1], line[-1:]
    if not text or told not in (checksum(text), checksum(text[:-1]) if text.endswith(b";") else b""):
        return None
    return text


def encode_values(values: Integers, width: int) -> bytes:
    """Values (n,), `width` characters each, the highest six bits first."""
    shifts = 6 * np.arange(width - 1, -1, -1)
    return (((values[:, None] >> shifts) & 0x3F) + OFFSET).astype(np.uint8).tobytes()


def decode_values(characters: Bytes, width: int) -> tuple[Integers, Flags]:
    """Values (n,) of n * width characters, and whether all of a value's characters can stand for bits."""
    groups = characters.reshape(-1, width).astype(np.int64) - OFFSET
    good: Flags = np.asarray(((groups >= 0) & (groups < 64)).all(axis=1))
    return (groups << (6 * np.arange(width - 1, -1, -1))).sum(axis=1), good


def parse_clock(line: bytes) -> int | None:
    """Milliseconds on the device's clock, modulo 2^24; None where the line is damaged."""
    text = strip_checksum(line)
    if text is None or len(text) != 4:
        return None
    values, good = decode_values(np.frombuffer(text, np.uint8), 4)
    return int(values[0]) if good[0] else None


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply as it came: echo, status, its lines with their checksums, and the bytes fed up to its end."""

    echo: bytes
    status: str
    lines: tuple[bytes, ...]
    end: int

    def packet(self) -> bytes:
        """The bytes that the device sends."""
        status = self.status.encode("ascii")
        return b"\n".join([self.echo, status + checksum(status), *self.lines, b"", b""])


class ReplyParser:
    """Replies out of bytes in any chunks. What is too long, or has no status, is passed over and counted."""

    def __init__(self) -> None:
        self.bytes_skipped = 0
        self._position = 0
        self._line = bytearray()
        self._lines: list[bytes] = []
        self._overlong = False

    def feed(self, data: bytes) -> list[Reply]:
        """The replies that these bytes complete."""
        replies: list[Reply] = []
        at = 0
        while (end := data.find(b"\n", at)) >= 0:
            self._extend(data[at:end])
            at = end + 1
            line, self._line = bytes(self._line), bytearray()
            if line:
                self._add(line)
            elif self._lines or self._overlong:
                reply = self._reply(self._position + at)
                if reply is not None:
                    replies.append(reply)
        self._extend(data[at:])
        self._position += len(data)
        return replies

    def _extend(self, part: bytes) -> None:
        room = MAX_LINE_LENGTH - len(self._line)
        self._line += part[:room]
        if len(part) > room:
            self._overlong = True
            self.bytes_skipped += len(part) - room

    def _add(self, line: bytes) -> None:
        if len(self._lines) < MAX_LINES:
            self._lines.append(line)
        else:
            self._overlong = True
            self.bytes_skipped += len(line) + 1

    def _reply(self, end: int) -> Reply | None:
        """The reply that the held lines make, None where they make none."""
        lines, self._lines = self._lines, []
        overlong, self._overlong = self._overlong, False
        if not overlong and len(lines) >= 2:
            status = (
                lines[1] if len(lines[1]) == 1 else strip_checksum(lines[1])
            )  # SCIP 1.1 has a status without checksum
            if status is not None and len(status) <= 2 and status.isascii():
                return Reply(lines[0], status.decode("ascii"), tuple(lines[2:]), end)
        self.bytes_skipped += sum(len(line) + 1 for line in lines)
        return None


@dataclass(frozen=True, slots=True)
class Parameters:
    """What the device is, from its reply to PP.

    model               as it calls itself
    range_min, range_max  metres; smaller values are error codes
    steps               in a full turn
    first, last, front  steps: the first and the last that can be measured, and the one that looks ahead
    speed               revolutions a minute
    """

    model: str
    range_min: float
    range_max: float
    steps: int
    first: int
    last: int
    front: int
    speed: float

    @property
    def step_period(self) -> float:
        """Seconds from step to step."""
        return 60.0 / self.speed / self.steps

    @classmethod
    def parse(cls, reply: Reply) -> Parameters:
        """Raises DriverError where the reply lacks something or is damaged."""
        fields: dict[str, str] = {}
        for line in reply.lines:
            text = strip_checksum(line)
            if text is None:
                raise DriverError("the lidar's parameters came damaged")
            name, _, value = text.decode("ascii", errors="replace").rstrip(";").partition(":")
            fields[name] = value
        try:
            numbers = {name: int(fields[name]) for name in ("DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN")}
        except (KeyError, ValueError) as error:
            raise DriverError(f"the lidar's parameters make no sense: {error}") from error
        if not (numbers["ARES"] > 0 and numbers["SCAN"] > 0 and 0 <= numbers["AMIN"] <= numbers["AMAX"] <= 9999):
            raise DriverError(f"the lidar's parameters make no sense: {numbers}")
        return cls(
            fields.get("MODL", ""),
            numbers["DMIN"] / 1e3,
            numbers["DMAX"] / 1e3,
            numbers["ARES"],
            numbers["AMIN"],
            numbers["AMAX"],
            numbers["AFRT"],
            float(numbers["SCAN"]),
        )

    def lines(self) -> tuple[bytes, ...]:
        """The lines of the reply that tells them."""
        numbers = {
            "DMIN": self.range_min * 1e3,
            "DMAX": self.range_max * 1e3,
            "ARES": self.steps,
            "AMIN": self.first,
            "AMAX": self.last,
            "AFRT": self.front,
            "SCAN": self.speed,
        }
        texts = [f"MODL:{self.model}", *(f"{name}:{round(value)}" for name, value in numbers.items())]
        return tuple(text.encode("ascii") + b";" + checksum(text.encode("ascii")) for text in texts)


@dataclass(frozen=True, slots=True)
class MeasureRequest:
    """A request for measurements of the steps `first` to `last`, in clusters of `cluster` neighbours whose nearest is
    told.

    continuous  MD and MS, which keep coming until STOP; GD and GS answer once
    width       characters a value: 3, or 2 for less than 4.096 m
    skip        scans left out between two
    """

    first: int
    last: int
    cluster: int = 1
    continuous: bool = True
    width: int = 3
    skip: int = 0

    @property
    def count(self) -> int:
        """Values in a scan."""
        return math.ceil((self.last - self.first + 1) / self.cluster)

    @property
    def echo_prefix(self) -> bytes:
        """What every echo begins with."""
        command = ("M" if self.continuous else "G") + ("D" if self.width == 3 else "S")
        text = f"{command}{self.first:04d}{self.last:04d}{self.cluster:02d}"
        return (text + (f"{self.skip:01d}" if self.continuous else "")).encode("ascii")

    def packet(self) -> bytes:
        """The bytes to send; continuous measurements are asked for without end."""
        return self.echo_prefix + (b"00" if self.continuous else b"") + b"\n"

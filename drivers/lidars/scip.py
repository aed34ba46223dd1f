"""Hokuyo's SCIP 2.0: ASCII commands and replies. `scip_scan` decodes the measurements.

A reply consists of the command's echo, a status with a checksum, lines with a checksum each, and an empty line.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import DriverError
from .measurements import Bytes, Flags, Integers

OFFSET = 0x30
"""Characters 0x30 to 0x6F encode six bits each."""
LINE_LENGTH = 64
"""Characters of data in a line, before its checksum."""
MAX_LINE_LENGTH = 256
MAX_LINES = 256
"""Lines of a reply; 1 921 steps of three characters, the maximum of a Hokuyo, take 91."""
OK = "00"
ECHO = ord("&")
"""Character before all returns of a step but the first."""
DATA = "99"
"""Status of the replies of a continuous measurement."""

STOP = b"QT\n"
LASER_ON = b"BM\n"
PARAMETERS = b"PP\n"
VERSION = b"VV\n"
STATE = b"II\n"
USE_SCIP2 = b"SCIP2.0\n"
"""Command to a device that replies `E` because it still uses SCIP 1.1."""


def checksum(text: bytes) -> bytes:
    """Return the character that follows `text`: the lowest six bits of the sum."""
    return bytes([(sum(text) & 0x3F) + OFFSET])


def strip_checksum(line: bytes) -> bytes | None:
    """Return a line without its checksum; None if the checksum is wrong.

    Lines of parameters have a semicolon before the checksum, which is not summed.
    """
    text, stored = line[:-1], line[-1:]
    if not text or stored not in (checksum(text), checksum(text[:-1]) if text.endswith(b";") else b""):
        return None
    return text


def encode_values(values: Integers, width: int) -> bytes:
    """Encode values (n,) in `width` characters each, the highest six bits first."""
    shifts = 6 * np.arange(width - 1, -1, -1)
    return (((values[:, None] >> shifts) & 0x3F) + OFFSET).astype(np.uint8).tobytes()


def decode_values(characters: Bytes, width: int) -> tuple[Integers, Flags]:
    """Decode values (n,) of n * width characters; also return whether all characters of each value are valid."""
    groups = characters.reshape(-1, width).astype(np.int64) - OFFSET
    good: Flags = np.asarray(((groups >= 0) & (groups < 64)).all(axis=1))
    return (groups << (6 * np.arange(width - 1, -1, -1))).sum(axis=1), good


def parse_clock(line: bytes) -> int | None:
    """Return the device's clock in milliseconds modulo 2^24; None if the line is damaged."""
    text = strip_checksum(line)
    if text is None or len(text) != 4:
        return None
    values, good = decode_values(np.frombuffer(text, np.uint8), 4)
    return int(values[0]) if good[0] else None


def encode_text_lines(texts: Iterable[str]) -> tuple[bytes, ...]:
    """Return lines of text, each with a semicolon and its checksum."""
    return tuple(text.encode("ascii") + b";" + checksum(text.encode("ascii")) for text in texts)


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply as received: echo, status, lines with their checksums, and the number of bytes fed up to its end."""

    echo: bytes
    status: str
    lines: tuple[bytes, ...]
    end: int

    def packet(self) -> bytes:
        """Return the bytes that the device sends."""
        status = self.status.encode("ascii")
        return b"\n".join([self.echo, status + checksum(status), *self.lines, b"", b""])


class ReplyParser:
    """Search for replies in bytes, in any chunks. Bytes of replies that are too long or have no status are skipped and
    counted.
    """

    def __init__(self) -> None:
        self.bytes_skipped = 0
        self._position = 0
        self._line = bytearray()
        self._lines: list[bytes] = []
        self._overlong = False

    def feed(self, data: bytes) -> list[Reply]:
        """Return the replies that these bytes complete."""
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
        """Return the reply consisting of the collected lines; None if they form none."""
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
    """Properties of the device, from its reply to PP.

    model                 name of the model
    range_min, range_max  metres; smaller values are error codes
    steps                 steps per full turn
    first, last, front    steps: the first and the last that can be measured, and the one straight ahead
    speed                 revolutions per minute
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
        """Parse the reply to PP; raises DriverError if it is incomplete or damaged."""
        fields: dict[str, str] = {}
        for line in reply.lines:
            text = strip_checksum(line)
            if text is None:
                raise DriverError("the lidar's parameters arrived damaged")
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
        """Return the lines of the reply with these parameters."""
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
        return encode_text_lines(texts)


@dataclass(frozen=True, slots=True)
class MeasureRequest:
    """A request for measurements of the steps `first` to `last`, in clusters of `cluster` neighbours of which the
    nearest is reported.

    continuous  True for MD, MS, ME, ND and NE, which repeat until STOP; False for GD, GS, GE, HD and HE, which reply
                once
    width       characters per value: 3, or 2 for ranges below 4.096 m
    skip        scans left out between two
    intensity   True for ME, GE, NE and HE: each range is followed by the intensity of its return, of the same width
    echoes      True for ND, NE, HD and HE: several ranges for each step
    """

    first: int
    last: int
    cluster: int = 1
    continuous: bool = True
    width: int = 3
    skip: int = 0
    intensity: bool = False
    echoes: bool = False

    @property
    def count(self) -> int:
        """Number of values in a scan."""
        return math.ceil((self.last - self.first + 1) / self.cluster)

    @property
    def characters(self) -> int:
        """Number of characters of a range, with its intensity if that is requested."""
        return (1 + self.intensity) * self.width

    @property
    def echo_prefix(self) -> bytes:
        """Beginning of every echo."""
        command = ("MN" if self.continuous else "GH")[self.echoes]
        command += "E" if self.intensity else "D" if self.width == 3 else "S"
        text = f"{command}{self.first:04d}{self.last:04d}{self.cluster:02d}"
        return (text + (f"{self.skip:01d}" if self.continuous else "")).encode("ascii")

    def packet(self) -> bytes:
        """Return the bytes to send; continuous measurements are requested without a limit."""
        return self.echo_prefix + (b"00" if self.continuous else b"") + b"\n"

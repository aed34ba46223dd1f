"""Common interface of all wheel base protocols: readings, requests, and parsers on bytes without ports or threads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeAlias

from .kinematics import DifferentialDrive


@dataclass(frozen=True, slots=True)
class WheelReading:
    """Reading of both wheel encoders.

    left, right  encoder counts as sent, signed or unsigned, wrapping as the encoders do
    time         time of measurement in units of the base's `tick`, wrapping at its `wraps_at`; None if the protocol has
                 no time
    heading      gyro heading, radians counter-clockwise from an arbitrary start, in [-pi, pi); None if there is no gyro
    battery      volts; None if the protocol does not contain it
    """

    left: int
    right: int
    time: int | None = None
    heading: float | None = None
    battery: float | None = None


@dataclass(slots=True)
class ParserCounters:
    """Counters of a parser.

    good      valid readings (host's side) or requests (device's side)
    bad       complete frames or lines that were damaged or unknown
    skipped   bytes outside of valid frames and lines
    lost      readings that are missing according to the device's numbering
    restarts  number of times that the device's numbering restarted
    """

    good: int = 0
    bad: int = 0
    skipped: int = 0
    lost: int = 0
    restarts: int = 0


@dataclass(frozen=True, slots=True)
class Velocity:
    """Request to drive at a speed (m/s, forwards) and a turn rate (rad/s, counter-clockwise)."""

    speed: float
    turn_rate: float


@dataclass(frozen=True, slots=True)
class Poll:
    """Request for one reading."""


@dataclass(frozen=True, slots=True)
class Stream:
    """Request to start or stop sending readings continuously."""

    on: bool


@dataclass(frozen=True, slots=True)
class Reset:
    """Request to set the counts of both wheels to zero."""


Request: TypeAlias = Velocity | Poll | Stream | Reset


class WheelBase(Protocol):
    """Host's side of a wheel base protocol.

    baud         bits per second, 8N1
    tick         seconds per unit of a reading's time; None if the protocol has no time
    wraps_at     units at which a reading's time wraps to zero; None if it does not
    poll_period  seconds between polls of a base that only responds to requests; None if it sends without them
    wheels       dimensions of the drive
    counters     counters of the parser
    """

    name: ClassVar[str]
    baud: ClassVar[int]
    tick: ClassVar[float | None]
    wraps_at: ClassVar[int | None]
    poll_period: ClassVar[float | None]
    wheels: DifferentialDrive
    counters: ParserCounters

    def start(self) -> bytes:
        """Return the bytes that start readings; may be empty. They do not enable driving."""
        ...

    def poll(self) -> bytes:
        """Return the bytes that request one reading; empty for a base that sends without requests."""
        ...

    def enable_driving(self) -> bytes:
        """Return the bytes after which the base obeys drive commands, to be sent before each motion; may be empty."""
        ...

    def drive(self, velocity: Velocity) -> bytes:
        """Return the bytes of a drive command. A velocity beyond the top speed is reduced along the same arc."""
        ...

    def end(self) -> bytes:
        """Return the bytes that end the readings, not the motion; empty if the protocol cannot end them."""
        ...

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """Return the readings that a chunk completes, independent of the division of the stream into chunks.

        Damaged readings are skipped and counted.
        """
        ...


class WheelDevice(Protocol):
    """Device's side of a wheel base protocol, for emulators."""

    counters: ParserCounters

    def encode(self, reading: WheelReading) -> bytes:
        """Return the bytes of a reading; its counts are wrapped as the base's."""
        ...

    def feed(self, chunk: bytes) -> list[Request]:
        """Return the requests that a chunk from the host completes."""
        ...


def to_signed(value: int, bits: int) -> int:
    """Return a count wrapped to a signed integer (two's complement) of this many bits."""
    half = 1 << (bits - 1)
    return (value + half) % (1 << bits) - half

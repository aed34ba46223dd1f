"""What wheel bases tell and are told, whatever their protocol; bytes in and out, no ports, no clocks, no threads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeAlias

from .kinematics import DifferentialDrive


@dataclass(frozen=True, slots=True)
class WheelReading:
    """One reading of both wheels.

    left, right  encoder counts as they were sent, signed or not, wrapping as the encoders do
    time         when it was measured, in units of the base's `tick` and wrapping at its `wraps_at`; None where the
                 protocol carries no time
    heading      of a gyro, radians counter-clockwise from wherever it started, wrapped to [-pi, pi); None without
    battery      volts; None where the protocol does not tell
    """

    left: int
    right: int
    time: int | None = None
    heading: float | None = None
    battery: float | None = None


@dataclass(slots=True)
class Counters:
    """What a parser has seen.

    good      readings, or requests on the device's side
    bad       frames or lines that were complete but damaged or not understood
    skipped   bytes that belong to nothing, the damaged frames' and lines' included
    lost      readings that the device numbered and that never came
    restarts  times when a device began to number from elsewhere
    """

    good: int = 0
    bad: int = 0
    skipped: int = 0
    lost: int = 0
    restarts: int = 0


@dataclass(frozen=True, slots=True)
class Velocity:
    """Drive at a speed (m/s, forwards) and a turn rate (rad/s, counter-clockwise)."""

    speed: float
    turn_rate: float


@dataclass(frozen=True, slots=True)
class Poll:
    """Send one reading."""


@dataclass(frozen=True, slots=True)
class Stream:
    """Send readings from now on, or no longer."""

    on: bool


@dataclass(frozen=True, slots=True)
class Reset:
    """Set the counts of both wheels to zero."""


Request: TypeAlias = Velocity | Poll | Stream | Reset


class WheelBase(Protocol):
    """The host's side of a protocol.

    baud         bits a second, 8N1
    tick         seconds per unit of a reading's time, wraps_at units after which it begins again; None: no time
    poll_period  seconds between polls of a base that only answers; None: it sends by itself
    wheels       the drive's measures
    counters     what was seen so far
    """

    name: ClassVar[str]
    baud: ClassVar[int]
    tick: ClassVar[float | None]
    wraps_at: ClassVar[int | None]
    poll_period: ClassVar[float | None]
    wheels: DifferentialDrive
    counters: Counters

    def start(self) -> bytes:
        """What to send so that readings come and velocities are obeyed; may be empty."""
        ...

    def poll(self) -> bytes:
        """What to send for one reading; empty for a base that sends by itself."""
        ...

    def drive(self, velocity: Velocity) -> bytes:
        """What to send to drive. Too fast a velocity is slowed down along the same arc."""
        ...

    def stop(self) -> bytes:
        """What to send so that the wheels stand and, where it can be had, the base falls silent."""
        ...

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """The readings that a chunk completes. The same bytes give the same readings however they are cut into
        chunks; damaged ones are skipped and counted.
        """
        ...


class WheelDevice(Protocol):
    """The base's own side of a protocol, for an emulator of it."""

    counters: Counters

    def encode(self, reading: WheelReading) -> bytes:
        """The bytes by which the base tells a reading; counts are wrapped as the base's are."""
        ...

    def feed(self, chunk: bytes) -> list[Request]:
        """The requests that a chunk from the host completes."""
        ...


def signed(value: int, bits: int) -> int:
    """A count of any size as the number of so many bits in two's complement that it wraps to."""
    half = 1 << (bits - 1)
    return (value + half) % (1 << bits) - half

"""Velocity commands to a wheel base: limits, and when the base is stopped.

The commands come from another process or thread, at any rate. The thread that reads the base also writes to it: it
repeats the last command while it is valid, and a stop otherwise. So the base stops if the program that gives the
commands is slow, stopped or killed, and if the base itself sends no readings any more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..bases.interface import Velocity, WheelBase
from ..errors import DriverError
from .device_spec import DeviceSpec

COMMAND_TIMEOUT = 0.5
"""Seconds for which a command is valid, as in the project's wheel protocol: a robot at 0.2 m/s drives 0.1 m meanwhile.
"""
ANSWER_TIMEOUT = 0.5
"""Seconds without a reading after which the base does not answer any more."""
REPEAT_PERIOD = 0.1
"""Seconds between repetitions of a command. They replace damaged commands, and bases with a timeout of their own, which
is half a second at least, drive on.
"""
STOPPED = Velocity(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class DriveLimits:
    """Permission to drive, and the limits of it.

    speed      m/s in either direction, above 0
    turn_rate  rad/s in either direction, above 0

    Raises DriverError if a limit is not a positive number.
    """

    speed: float = 0.2
    turn_rate: float = 1.0

    def __post_init__(self) -> None:
        if not all(math.isfinite(limit) and limit > 0.0 for limit in (self.speed, self.turn_rate)):
            raise DriverError("the limits of speed and turn rate must be numbers above 0")

    def apply(self, velocity: Velocity) -> Velocity:
        """Return the velocity within the limits; both parts are reduced by the same factor, which keeps the arc."""
        excess = max(1.0, abs(velocity.speed) / self.speed, abs(velocity.turn_rate) / self.turn_rate)
        return Velocity(velocity.speed / excess, velocity.turn_rate / excess)


@dataclass(frozen=True, slots=True)
class DriveCommand:
    """Velocity to drive, and the time of the command on the steady clock, seconds, which all processes share."""

    velocity: Velocity
    time: float


def driven_base(specs: Sequence[DeviceSpec]) -> DeviceSpec:
    """Return the wheel base among the devices; raises DriverError unless there is exactly one."""
    bases = [spec for spec in specs if not spec.is_lidar]
    if len(bases) != 1:
        raise DriverError(f"driving requires exactly one wheel base; {len(bases)} are given")
    return bases[0]


class BaseDriver:
    """Commands to one base, over all its connections. `put` may be called from any thread.

    limits  of the velocities
    """

    def __init__(self, limits: DriveLimits) -> None:
        self._limits = limits
        self._command: DriveCommand | None = None
        self._sent: Velocity | None = None  # last command that was sent; None before the first one
        self._sent_at = -math.inf

    def put(self, command: DriveCommand) -> None:
        """Replace the last command."""
        self._command = command

    def output(self, protocol: WheelBase, now: float, last_reading: float) -> bytes:
        """Return the bytes that are due; they are to be sent at once.

        now           time on the steady clock, seconds
        last_reading  time of the last reading, seconds; minus infinity before the first one of a connection
        """
        velocity = self._velocity(now, last_reading)
        if velocity is None or (velocity == self._sent and now < self._sent_at + REPEAT_PERIOD):
            return b""
        begins = velocity != STOPPED and self._sent in (None, STOPPED)
        self._sent, self._sent_at = velocity, now
        return (protocol.enable_driving() if begins else b"") + protocol.drive(velocity)

    def stop(self, protocol: WheelBase) -> bytes:
        """Return the bytes that stop the base, if it was ever driven."""
        if self._sent is None:
            return b""
        self._sent = STOPPED
        return protocol.drive(STOPPED)

    def restart(self, protocol: WheelBase) -> bytes:
        """Return the bytes that stop the base on a new connection, if it was ever driven: it may still move."""
        stop = self.stop(protocol)
        return protocol.enable_driving() + stop if stop else b""

    def _velocity(self, now: float, last_reading: float) -> Velocity | None:
        """Return the velocity to drive; None before the first command."""
        command = self._command
        if command is None:
            return None
        valid = now < command.time + COMMAND_TIMEOUT and now < last_reading + ANSWER_TIMEOUT
        return self._limits.apply(command.velocity) if valid else STOPPED

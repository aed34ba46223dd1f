"""Driving the robot with the keys of the terminal."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from drivers.devices.driving import DriveLimits

KEY_TIMEOUT = 0.5
"""Seconds that the robot drives after a key: a terminal repeats a key while it is held, after 0.25 to 0.5 s."""
COMMAND_PERIOD = 0.1
"""Seconds between two commands of the same velocity, a fraction of the time for which a command is valid."""
KEY_PATTERN = re.compile(rb"\x1b\[[A-DHF]|\x1bO[A-DHF]|\x1b\[[1-8]~")
STOP_KEY, STOPPED = b" ", (0, 0)
DIRECTIONS = {
    b"A": (1, 0),
    b"B": (-1, 0),
    b"C": (0, -1),
    b"D": (0, 1),
    b"H": (1, 1),
    b"1~": (1, 1),
    b"7~": (1, 1),
    b"5~": (1, -1),
    b"F": (-1, -1),
    b"4~": (-1, -1),
    b"8~": (-1, -1),
    b"6~": (-1, 1),
}
"""(forwards, counter-clockwise) by the end of a key's escape sequence: arrows, Home, Page Up, End, Page Down, which lie
on a numeric keypad in the directions in which the robot drives.
"""
HELP = "arrows, Home, Page Up, End, Page Down: drive while held; space: stop"


class Drivable(Protocol):
    """Robot that can be driven."""

    def drive(self, speed: float, turn_rate: float) -> None:
        """Drive at a speed (m/s) and a turn rate (rad/s) for half a second."""
        ...


class Teleoperation:
    """Driver of a robot by keys: a key drives in its direction, at the limits, until KEY_TIMEOUT after its last repeat.

    Other keys change nothing. After the space bar or the timeout the robot is stopped once; then nothing is sent, so
    that other sources of commands are not disturbed.
    """

    def __init__(self, robot: Drivable, limits: DriveLimits) -> None:
        self._robot, self._limits = robot, limits
        self._direction = STOPPED
        self._pressed_at = self._sent_at = float("-inf")

    def handle(self, keys: bytes) -> None:
        """Process pressed keys, as a terminal sends them, and the time since the last ones."""
        now, before, stop = time.monotonic(), self._direction, STOP_KEY in keys
        for key in KEY_PATTERN.findall(keys):
            self._direction, self._pressed_at = DIRECTIONS.get(key[2:], before), now
        if stop or now > self._pressed_at + KEY_TIMEOUT:
            self._direction = STOPPED
        repeats = self._direction != STOPPED and now >= self._sent_at + COMMAND_PERIOD
        if stop or repeats or self._direction != before:
            self._sent_at = now
            forwards, left = self._direction
            self._robot.drive(forwards * self._limits.speed, left * self._limits.turn_rate)

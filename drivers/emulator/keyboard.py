"""Driving with the arrow keys of the emulator's terminal."""

from __future__ import annotations

import os
import re
import select
import sys
import termios
import tty
from types import TracebackType

from ..bases.interface import Velocity
from ..errors import DriverError

SPEED_STEP, TURN_RATE_STEP = 0.1, 0.25
"""Metres and radians per second that a key adds."""
MAX_SPEED, MAX_TURN_RATE = 0.5, 1.5
KEY_PATTERN = re.compile(rb"\x1b\[[A-D]|\x1bO[A-D]|[wasdWASD ]")
ARROW_STEPS = {b"A": (1, 0), b"B": (-1, 0), b"C": (0, -1), b"D": (0, 1)}
"""(forwards, counter-clockwise) by the last character of an arrow key's escape sequence."""
LETTER_ARROWS = {b"w": b"A", b"s": b"B", b"d": b"C", b"a": b"D"}
HELP = "arrow keys: faster, slower, left, right; space: stop"


def apply_keys(velocity: Velocity, keys: bytes) -> Velocity:
    """Return the velocity after keys, as a terminal sends them; the space bar stops, unknown keys are ignored."""
    for key in KEY_PATTERN.findall(keys):
        if key == b" ":
            velocity = Velocity(0.0, 0.0)
            continue
        forwards, left = ARROW_STEPS[LETTER_ARROWS.get(key.lower(), key[-1:])]
        speed, turn_rate = velocity.speed + forwards * SPEED_STEP, velocity.turn_rate + left * TURN_RATE_STEP
        velocity = Velocity(min(max(speed, -MAX_SPEED), MAX_SPEED), min(max(turn_rate, -MAX_TURN_RATE), MAX_TURN_RATE))
    return velocity


class Keyboard:
    """The keys of the terminal; a context manager. Raises DriverError if standard input is no terminal."""

    def __init__(self) -> None:
        if not sys.stdin.isatty():
            raise DriverError("there is no keyboard: standard input is not a terminal")
        self._input = sys.stdin.fileno()

    def __enter__(self) -> Keyboard:
        self._before = termios.tcgetattr(self._input)
        tty.setcbreak(self._input)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        termios.tcsetattr(self._input, termios.TCSADRAIN, self._before)

    def read_keys(self) -> bytes:
        """Return the characters typed since the last call, without waiting."""
        ready, _, _ = select.select([self._input], [], [], 0.0)
        return os.read(self._input, 256) if ready else b""

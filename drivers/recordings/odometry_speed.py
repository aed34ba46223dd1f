"""Recognise odometry that is too fast for its unit to be metres."""

from __future__ import annotations

import math

import numpy as np

from ..messages import Floats, Message, Odometry

FASTEST = 30.0
"""m/s. Origin: chosen, a car outside of towns; a robot exceeds it from 0.03 m/s on if its odometry is in millimetres,
and from 0.3 m/s on in centimetres."""
MIN_INTERVAL = 0.02
"""Seconds. Shorter intervals are taken as this long, so that jitter of the stamps is not taken for speed."""


class OdometrySpeed:
    """Counts the steps of odometry that move the robot, and those of them that are faster than FASTEST."""

    def __init__(self) -> None:
        self._moves = self._fast = 0
        self._last: tuple[float, float, float] | None = None

    def add(self, message: Message) -> None:
        """Process the next message of a recording, in time order."""
        if not isinstance(message, Odometry):
            return
        x, y, _ = message.pose.tolist()
        if self._last is not None:
            stamp, last_x, last_y = self._last
            self._count(message.stamp - stamp, math.hypot(x - last_x, y - last_y))
        self._last = message.stamp, x, y

    @classmethod
    def of_path(cls, stamps: Floats, positions: Floats) -> OdometrySpeed:
        """Return the counts of a path: (n,) stamps, seconds, and (n, 2) positions."""
        speed = cls()
        distances = np.hypot(*np.diff(positions, axis=0).T)
        for elapsed, distance in zip(np.diff(stamps).tolist(), distances.tolist(), strict=True):
            speed._count(elapsed, distance)
        return speed

    def describe(self) -> str | None:
        """Return one line of text if most of the steps that move the robot are too fast, else None."""
        if 2 * self._fast <= self._moves:
            return None
        return f"odometry is faster than {FASTEST:g} m/s wherever it moves, as if in millimetres or centimetres"

    def _count(self, elapsed: float, distance: float) -> None:
        """Count a step of some seconds and metres."""
        self._moves += distance > 0.0
        self._fast += distance > FASTEST * max(elapsed, MIN_INTERVAL)

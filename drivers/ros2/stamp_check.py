"""Check of the stamps of sensors that arrive live: in their order, and of one clock.

Clocks are set while a robot runs: a computer without a battery-backed clock gets the time from the network, a
simulation is reset, and nodes that start before simulated time does stamp their first messages with zero. A stamp far
ahead would make all later ones of its sensor seem old, and the robot drive for as long without a measurement.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping
from enum import StrEnum
from typing import TypeAlias

from ..messages import Message, Odometry, Scan, YawRate
from .silence import SILENCE

CLOCK_CONFIRMATIONS = 5
"""Messages in a row with such stamps after which it is the clock that is wrong. Origin: as in recordings."""
MAX_CLOCK_STEP = 5.0
"""Seconds by which a clock may be set back so that messages are dropped until it has caught up, and by which stamps of
scans and odometry may differ. Origin: chosen, about what it takes to finish a map and to recognise the place of the
robot in it; not measured.
"""

NAMES: Mapping[type[Message], str] = {Odometry: "odometry", Scan: "a lidar", YawRate: "a gyroscope"}
"""Names of the sensors in texts, by their messages."""

Sensor: TypeAlias = tuple[type[Message], int]
"""Type of a sensor's messages, and the number of the lidar."""


class Refusal(StrEnum):
    """Reasons for which a message is dropped."""

    REPEATED = "sent twice"
    LATE = "older than one received before"
    OTHER_CLOCK = "stamped far from those of the other sensor"


class StampCheck:
    """Check of one stamp after the other.

    was_set_back  true if the stamps of odometry and scans have begun again, by more than MAX_CLOCK_STEP earlier; to be
                  changed by `begin_again` only
    """

    def __init__(self, *, uses_odometry: bool) -> None:
        self.was_set_back = False
        self._uses_odometry = uses_odometry
        self._latest: dict[Sensor, float] = {}  # stamps of the last messages that were not refused
        self._received: dict[Sensor, tuple[float, float]] = {}  # stamp and arrival of the last messages of all
        self._older: Counter[Sensor] = Counter()  # messages in a row that are older than the latest one
        self._apart: Counter[Sensor] = Counter()  # messages in a row that are of another clock

    def begin_again(self) -> None:
        """Accept messages of any time."""
        self._latest.clear()
        self._received.clear()
        self._older.clear()
        self._apart.clear()
        self.was_set_back = False

    def refuse(self, sensor: Sensor, stamp: float, *, paused: bool = False) -> Refusal | None:
        """Return why a message of a sensor with a stamp (seconds) is dropped; None if it is not.

        paused  true if scans are not checked, as they are left out
        """
        latest, others = self._latest.get(sensor, -math.inf), self._recent_others(sensor)
        if stamp == latest:
            return Refusal.REPEATED
        is_near = any(abs(stamp - other) <= MAX_CLOCK_STEP for other in others)
        before, _ = self._received.get(sensor, (stamp, 0.0))
        self._received[sensor] = stamp, time.monotonic()
        if stamp < latest:
            self._older[sensor] += 1
            if latest - stamp > MAX_CLOCK_STEP and self._older[sensor] >= CLOCK_CONFIRMATIONS:
                self.was_set_back |= is_near or self._is_alone(sensor, paused=paused)
            return Refusal.LATE
        is_confirmed = is_near if others else abs(stamp - before) <= MAX_CLOCK_STEP
        if math.isinf(latest):  # until the others begin again, if their first stamp was wrong
            is_confirmed = is_confirmed and stamp >= self._latest_of_others(sensor) - MAX_CLOCK_STEP
        if stamp - latest > MAX_CLOCK_STEP and not is_confirmed:
            self._apart[sensor] += 1
            return Refusal.OTHER_CLOCK
        self._older[sensor] = self._apart[sensor] = 0
        self._latest[sensor] = stamp
        return None

    def problems(self) -> list[str]:
        """Return a line of text if messages are dropped because of the clock of a sensor."""
        lines = []
        if max(self._older.values(), default=0) >= CLOCK_CONFIRMATIONS:
            lines.append("the clock of a sensor was set back; its messages are dropped until it has caught up")
        for (kind, _), count in self._apart.items():
            if count >= CLOCK_CONFIRMATIONS:
                other = "the scans" if kind is Odometry else "odometry"
                lines.append(f"the clock of {NAMES[kind]} is not that of {other}; its messages are dropped until it is")
        return lines

    def _recent_others(self, sensor: Sensor) -> list[float]:
        """Return the last stamps with which those of a sensor can be compared: of scans for odometry, else of odometry.

        A sensor that is silent tells nothing about the time.
        """
        arrived = time.monotonic() - SILENCE
        return [self._received[other][0] for other in self._others(sensor) if self._received[other][1] >= arrived]

    def _latest_of_others(self, sensor: Sensor) -> float:
        return max((self._latest.get(other, -math.inf) for other in self._others(sensor)), default=-math.inf)

    def _others(self, sensor: Sensor) -> list[Sensor]:
        wanted = Scan if sensor[0] is Odometry else Odometry
        return [other for other in self._received if other[0] is wanted]

    def _is_alone(self, sensor: Sensor, *, paused: bool) -> bool:
        """Return True if no other sensor can be expected to be older, too; if one is, its clock is wrong."""
        return sensor[0] is (Scan if not self._uses_odometry else Odometry if paused else None)

"""Common part of all emulated devices."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TypeVar

from ..messages import Floats
from .serial_line import SerialLine

Time = TypeVar("Time", float, Floats)
"""Seconds, a single value or an array."""


class EmulatedDevice(ABC):
    """A device on a line, with a clock of its own that starts when it is switched on.

    name          chosen by the user
    line          to the host
    drift         relative rate error of its clock; positive if it runs fast
    usb_powered   True if it loses its power when it is unplugged
    on            True if it has power
    restarts      number of times that it was switched on or restarted, except the first
    requests      number of requests understood
    """

    def __init__(self, name: str, line: SerialLine, drift: float, usb_powered: bool) -> None:
        self.name, self.line, self.drift, self.usb_powered = name, line, drift, usb_powered
        self.on = False
        self.restarts = -1
        self.requests = 0
        self._powered_since = 0.0

    def switch_on(self, time: float) -> None:
        """Start or restart."""
        self.on = True
        self.restarts += 1
        self._powered_since = time

    def switch_off(self) -> None:
        """Switch the power off."""
        self.on = False

    @abstractmethod
    def on_port_opened(self, time: float) -> None:
        """React to a program that has opened the port."""

    def inject_error(self, time: float) -> bool:
        """Enter an internal error state that only a reset ends; return False if the device has no such state."""
        return False

    @property
    def due(self) -> float:
        """Time of its next action; infinite while it waits for the host."""
        return math.inf

    @property
    @abstractmethod
    def unrecognised(self) -> int:
        """Bytes from the host that it did not understand."""

    @abstractmethod
    def receive(self, data: bytes, time: float) -> None:
        """Process bytes from the host."""

    @abstractmethod
    def advance(self, time: float) -> None:
        """Perform all actions that are due up to a time."""

    @abstractmethod
    def report(self) -> dict[str, object]:
        """Return counts of its actions, by name."""

    def to_device_time(self, time: Time) -> Time:
        """Convert a time to the device's clock, seconds since it was switched on."""
        return (time - self._powered_since) * (1.0 + self.drift)

    def to_host_time(self, own: Time) -> Time:
        """Convert a time on the device's clock to the host's."""
        return self._powered_since + own / (1.0 + self.drift)

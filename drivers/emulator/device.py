"""What all emulated devices have in common."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TypeVar

from ..messages import Floats
from .serial_line import SerialLine

Time = TypeVar("Time", float, Floats)
"""Seconds, one or many."""


class EmulatedDevice(ABC):
    """A device on a line, with a clock of its own that begins when it is switched on.

    name         as the user chose it
    line         to the host
    drift        by how much its clock is too fast, parts of one
    usb_powered  whether it loses its power when it is unplugged
    on           whether it has power
    restarts     times that it was switched on or started again, but for the first
    requests     understood from the host
    """

    def __init__(self, name: str, line: SerialLine, drift: float, usb_powered: bool) -> None:
        self.name, self.line, self.drift, self.usb_powered = name, line, drift, usb_powered
        self.on = False
        self.restarts = -1
        self.requests = 0
        self._powered_since = 0.0

    def switch_on(self, time: float) -> None:
        """Start, or start again."""
        self.on = True
        self.restarts += 1
        self._powered_since = time

    def switch_off(self) -> None:
        """Lose the power."""
        self.on = False

    @abstractmethod
    def on_port_opened(self, time: float) -> None:
        """A program has opened the port."""

    def inject_error(self, time: float) -> bool:
        """Have an inner error that only a reset mends; False where the device knows no such thing."""
        return False

    @property
    def due(self) -> float:
        """When it should be looked after next; infinite where it waits for the host."""
        return math.inf

    @property
    @abstractmethod
    def unrecognised(self) -> int:
        """Bytes from the host that it did not understand."""

    @abstractmethod
    def receive(self, data: bytes, time: float) -> None:
        """Take what the host has sent."""

    @abstractmethod
    def advance(self, time: float) -> None:
        """Do what is to be done until a time."""

    @abstractmethod
    def report(self) -> dict[str, object]:
        """What it did, by name."""

    def to_device_time(self, time: Time) -> Time:
        """A time on its own clock, seconds since it was switched on."""
        return (time - self._powered_since) * (1.0 + self.drift)

    def to_host_time(self, own: Time) -> Time:
        """The time when its own clock shows `own`."""
        return self._powered_since + own / (1.0 + self.drift)

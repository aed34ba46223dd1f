"""An emulated LD06 or LD19: it turns and sends from power-up on, and hears nothing."""

from __future__ import annotations

import math

import numpy as np

from ..lidars import ld06
from .device import Device
from .line import Line
from .optics import Optics

RATE = 10.0
"""Revolutions a second."""
SPIN_UP = 1.0
"""Seconds until it turns steadily."""
INTENSITY = 200
"""Of what came back."""


class Ld06(Device):
    """A one-way stream of packets of 12 measurements."""

    def __init__(self, name: str, line: Line, drift: float, optics: Optics) -> None:
        super().__init__(name, line, drift, usb_powered=True)
        self._optics = optics
        self._packets = 0  # since it was switched on
        self._heard = 0
        self.samples = 0

    def switch_on(self, time: float) -> None:
        """Begin to turn."""
        super().switch_on(time)
        self._packets = 0

    def port_opened(self, time: float) -> None:
        """It does not notice."""

    @property
    def misheard(self) -> int:
        """All that was sent to it."""
        return self._heard

    def hear(self, data: bytes, time: float) -> None:
        """Nothing: its receiving wire is not connected."""
        self._heard += len(data)

    @property
    def due(self) -> float:
        """When the next packet is complete."""
        return self.host(self._end()) if self.on else math.inf

    def _end(self) -> float:
        """Own time of the next packet's last point."""
        return SPIN_UP + ((self._packets + 1) * ld06.POINTS - 1) / ld06.SAMPLE_RATE

    def advance(self, time: float) -> None:
        """Measure and send what is due."""
        while time >= self.due:
            end = self._end()
            own = end - np.arange(ld06.POINTS - 1, -1, -1) / ld06.SAMPLE_RATE
            heads = 2.0 * np.pi * RATE * (own - SPIN_UP)
            ranges = self._optics.measure(self.host(own), -heads)
            intensities = np.where(np.isnan(ranges), 0, INTENSITY)
            told = (heads[[0, -1]][None], ranges[None], intensities[None])
            self.line.send(ld06.encode(*told, 2.0 * np.pi * RATE, end), self.host(end))
            self._packets += 1
            self.samples += ld06.POINTS

    def report(self) -> dict[str, object]:
        """Samples measured."""
        return {"samples": self.samples}

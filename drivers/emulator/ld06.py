"""An emulated LD06, LD19 or STL-27L: it turns and sends from power-up on, and receives nothing."""

from __future__ import annotations

import math

import numpy as np

from ..lidars import ld06
from .beam_model import BeamModel
from .device import EmulatedDevice
from .serial_line import SerialLine

ROTATION_RATE = 10.0
"""Revolutions per second."""
SPIN_UP_DURATION = 1.0
"""Seconds until it turns steadily."""
RETURN_INTENSITY = 228
"""Intensity of points with a return, as in the manual's example."""

LD06_VARIANTS = {"ld06": ld06.LD06, "stl-27l": ld06.STL_27L}
"""Models that can be emulated."""


class EmulatedLd06(EmulatedDevice):
    """A one-way stream of packets of 12 measurements."""

    def __init__(self, name: str, line: SerialLine, drift: float, beams: BeamModel, model: ld06.Model) -> None:
        super().__init__(name, line, drift, usb_powered=True)
        self._beams, self._model = beams, model
        self._packets = 0  # since it was switched on
        self._received_bytes = 0
        self.samples = 0

    def switch_on(self, time: float) -> None:
        """Start to turn."""
        super().switch_on(time)
        self._packets = 0

    def on_port_opened(self, time: float) -> None:
        """Do nothing: the device does not notice."""

    @property
    def unrecognised(self) -> int:
        """All bytes sent to it."""
        return self._received_bytes

    def receive(self, data: bytes, time: float) -> None:
        """Ignore the bytes: its receiving wire is not connected."""
        self._received_bytes += len(data)

    @property
    def due(self) -> float:
        """Time at which the next packet is complete."""
        return self.to_host_time(self._packet_end()) if self.on else math.inf

    def _packet_end(self) -> float:
        """Return the device time of the next packet's last point."""
        return SPIN_UP_DURATION + ((self._packets + 1) * ld06.POINTS - 1) / self._model.sample_rate

    def advance(self, time: float) -> None:
        """Measure and send all packets that are due."""
        while time >= self.due:
            end = self._packet_end()
            device_times = end - np.arange(ld06.POINTS - 1, -1, -1) / self._model.sample_rate
            heads = 2.0 * np.pi * ROTATION_RATE * (device_times - SPIN_UP_DURATION)
            ranges = self._beams.measure(self.to_host_time(device_times), -heads)
            intensities = np.where(np.isnan(ranges), 0, RETURN_INTENSITY)
            fields = (heads[[0, -1]][None], ranges[None], intensities[None])
            self.line.send(ld06.encode(*fields, 2.0 * np.pi * ROTATION_RATE, end), self.to_host_time(end))
            self._packets += 1
            self.samples += ld06.POINTS

    def report(self) -> dict[str, object]:
        """Return the number of samples measured."""
        return {"samples": self.samples}

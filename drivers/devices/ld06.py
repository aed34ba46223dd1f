"""LDROBOT LD06 and LD19, which send as long as they have power and accept no commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..errors import NoResponseError
from ..lidars import ld06
from ..transport import Transport
from .device import await_response
from .lidar import LidarDevice, LidarStream

LISTEN_DURATION = 1.0
"""Seconds; the lidar sends 375 packets per second."""
MIN_MEASUREMENTS = 36
"""Measurements, of three packets, that identify the lidar."""


class Ld06Device(LidarDevice):
    """An LD06 or LD19. Options: see `device_spec`."""

    def __init__(self, options: Mapping[str, Any]) -> None:
        super().__init__(options)
        self.bauds = (options.get("baud", ld06.BAUD),)

    def identify(self, transport: Transport, baud: int) -> None:
        """Listen for packets."""
        decoder = ld06.Ld06Decoder(baud=baud)

        def parse(data: bytes) -> bool | None:
            decoder.feed(data)
            return True if decoder.counters.samples >= MIN_MEASUREMENTS else None

        if await_response(transport, parse, LISTEN_DURATION) is None:
            raise NoResponseError(transport.name, "no LD06 or LD19 sends here; is it powered, does its head turn?")
        self.identity = "LDROBOT LD06 or LD19"

    def halt(self, transport: Transport) -> None:
        """Do nothing: the lidar stops only when its power is cut."""

    def _start_stream(self, transport: Transport, baud: int) -> LidarStream:
        decoder = ld06.Ld06Decoder(baud=baud)
        limits = (ld06.RANGE_MIN, ld06.RANGE_MAX)
        return LidarStream(decoder, ld06.POINTS / ld06.SAMPLE_RATE, ld06.LAYOUT.itemsize, limits)

"""LDROBOT LD06, LD19 and STL-27L, which send as long as they have power and accept no commands."""

from __future__ import annotations

from ..errors import NoResponseError
from ..lidars import ld06
from ..lidars.stray_points import find_stray_points
from ..transport import Transport
from .device import await_response
from .lidar import LidarDevice, LidarStream

LISTEN_DURATION = 1.0
"""Seconds; the lidars send 375 packets per second or more."""
MIN_MEASUREMENTS = 36
"""Measurements, of three packets, that identify the lidar."""


class Ld06Device(LidarDevice):
    """An LD06, LD19 or STL-27L, by its baud rate. Options: see `device_spec`."""

    bauds = tuple(model.baud for model in ld06.MODELS)

    def identify(self, transport: Transport, baud: int) -> None:
        """Listen for packets."""
        model = ld06.model_at(baud)
        decoder = ld06.Ld06Decoder(model, baud)

        def parse(data: bytes) -> bool | None:
            decoder.feed(data)
            return True if decoder.counters.samples >= MIN_MEASUREMENTS else None

        if await_response(transport, parse, LISTEN_DURATION) is None:
            raise NoResponseError(
                transport.name, "no LD06, LD19 or STL-27L sends here; is it powered, does its head turn?"
            )
        self.identity = f"LDROBOT {model.name}"

    def halt(self, transport: Transport) -> None:
        """Do nothing: the lidar stops only when its power is cut."""

    def start_stream(self, transport: Transport, baud: int) -> LidarStream:
        """Read from now on; the lidar sends anyway."""
        model = ld06.model_at(baud)
        return LidarStream(
            ld06.Ld06Decoder(model, baud),
            ld06.POINTS / model.sample_rate,
            ld06.LAYOUT.itemsize,
            (model.range_min, model.range_max),
            find_strays=find_stray_points if model.has_strays else None,
        )

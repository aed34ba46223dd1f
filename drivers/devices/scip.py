"""Hokuyo lidars with SCIP 2.0, on USB, RS-232 or Ethernet.

Every one of them reports ranges, some also intensities and several echoes of a beam. More than ranges is requested
only if the user selects such a scan mode: it takes twice the bytes or more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from ..errors import DriverError, NoResponseError
from ..lidars import scip, scip_scan
from ..lidars.scip import Parameters, Reply, ReplyParser
from ..transport import Transport
from .device import await_response, drain
from .lidar import LidarDevice, LidarStream

BAUDS = (115200, 19200, 38400)
"""Bits per second of RS-232 ports; USB and Ethernet accept any."""
RESPONSE_TIMEOUT = 0.5
"""Seconds; a measuring device may first finish a scan."""
MAX_TRIES = 2


class ScanMode(NamedTuple):
    """What to request for each step, and which of several echoes to use."""

    intensity: bool = False
    echoes: bool = False
    strongest: bool = False


SCAN_MODES = {
    "distance": ScanMode(),
    "intensity": ScanMode(intensity=True),
    "last": ScanMode(intensity=True, echoes=True),
    "strongest": ScanMode(intensity=True, echoes=True, strongest=True),
}
"""Scan modes by name: ranges only, also intensities, the last echo of each beam, the strongest one."""


class ScipDevice(LidarDevice):
    """A Hokuyo lidar. Options: see `device_spec`; with `baud` the port is assumed to be RS-232, with transmission
    delays.
    """

    bauds = BAUDS
    start_timeout = 10.0

    def __init__(self, options: Mapping[str, Any]) -> None:
        super().__init__(options)
        self._parameters: Parameters | None = None

    def identify(self, transport: Transport, baud: int) -> None:
        """Stop any measurement and query the device's identity."""
        transport.write(b"\n" + scip.STOP)
        drain(transport)
        reply = _request(transport, scip.PARAMETERS)
        if reply.status == "E":
            transport.write(scip.USE_SCIP2)
            drain(transport)
            reply = _request(transport, scip.PARAMETERS)
        self._parameters = Parameters.parse(reply)
        self.serial = _field(_request(transport, scip.VERSION), "SERI")
        self.identity = f"Hokuyo {self._parameters.model}, serial number {self.serial}"
        with suppress(NoResponseError):  # not every model has it
            state = _field(_request(transport, scip.STATE), "STAT")
            self.identity += f", {state}" if state else ""
        self.check_serial(transport)

    def halt(self, transport: Transport) -> None:
        """Stop measuring, which switches the laser off; the motor continues to turn."""
        transport.write(scip.STOP)

    def start_stream(self, transport: Transport, baud: int) -> LidarStream:
        """Start measuring in the mode that the options name."""
        assert self._parameters is not None
        parameters = self._parameters
        name = self._options.get("mode", "distance")
        if name not in SCAN_MODES:
            raise DriverError(f"{transport.name}: there is no scan mode {name!r}; there are: {', '.join(SCAN_MODES)}")
        mode = SCAN_MODES[name]
        request = scip.MeasureRequest(parameters.first, parameters.last, intensity=mode.intensity, echoes=mode.echoes)
        line_speed = baud if "baud" in self._options else math.inf
        decoder = scip_scan.ScipDecoder(parameters, request, line_speed, strongest=mode.strongest)
        _request(transport, scip.LASER_ON)
        if mode == SCAN_MODES["distance"]:  # which every lidar has
            transport.write(request.packet())
        elif (status := _request(transport, request.packet()).status) != scip.OK:
            raise DriverError(f"{transport.name}: the lidar has no scan mode {name!r} (status {status})")
        size = len(scip_scan.encode(np.zeros(request.count), request, 0))
        limits = (parameters.range_min, parameters.range_max)
        return LidarStream(decoder, 60.0 / parameters.speed, size, limits, whole_packets=True)


def _request(transport: Transport, command: bytes) -> Reply:
    """Send a command and return its reply; raises NoResponseError."""
    reader = ReplyParser()

    def parse(data: bytes) -> Reply | None:
        return next((reply for reply in reader.feed(data) if reply.echo == command.rstrip()), None)

    for _ in range(MAX_TRIES):
        transport.write(command)
        if parameters := await_response(transport, parse, RESPONSE_TIMEOUT):
            return parameters[0]
    raise NoResponseError(transport.name, "no lidar with SCIP responds here")


def _field(reply: Reply, name: str) -> str:
    """Return a field of a reply with lines such as `SERI:H0906091;`; empty if it is missing."""
    for line in reply.lines:
        text = scip.strip_checksum(line)
        if text is not None and text.startswith(name.encode() + b":"):
            return text.decode("ascii", errors="replace").partition(":")[2].rstrip(";")
    return ""

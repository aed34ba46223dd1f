"""Hokuyo's lidars with SCIP 2.0, on USB, RS-232 or Ethernet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import NoAnswerError
from ..lidars import scip, scip_scan
from ..lidars.scip import Parameters, Reply, ReplyReader
from ..transport import Transport
from .device import await_answer, drain
from .lidar import Lidar, Stream

BAUDS = (115200, 19200, 38400)
"""Bits a second of RS-232 ports; USB and Ethernet take any."""
ANSWER_TIMEOUT = 0.5
"""Seconds; a device that measures may first finish a scan."""
TRIES = 2


class Scip(Lidar):
    """A Hokuyo. Options: see `specs`; with `baud` the port is taken for RS-232, whose bytes take time."""

    patience = 10.0

    def __init__(self, options: Mapping[str, Any]) -> None:
        super().__init__(options)
        self.bauds = (options["baud"],) if "baud" in options else BAUDS
        self._parameters: Parameters | None = None

    def identify(self, transport: Transport, baud: int) -> None:
        """Silence it and ask who it is."""
        transport.write(b"\n" + scip.STOP)
        drain(transport)
        reply = _ask(transport, scip.PARAMETERS)
        if reply.status == "E":
            transport.write(scip.USE_SCIP2)
            drain(transport)
            reply = _ask(transport, scip.PARAMETERS)
        self._parameters = Parameters.parse(reply)
        self.serial = _field(_ask(transport, scip.VERSION), "SERI")
        self.identity = f"Hokuyo {self._parameters.model}, serial number {self.serial}"
        self.check_serial(transport)

    def halt(self, transport: Transport) -> None:
        """Stop measuring, which switches the laser off; the motor goes on turning."""
        transport.write(scip.STOP)

    def _begin(self, transport: Transport, baud: int) -> Stream:
        assert self._parameters is not None
        found = self._parameters
        request = scip.Measure(found.first, found.last)
        decoder = scip_scan.ScipDecoder(found, request, baud if "baud" in self._options else math.inf)
        _ask(transport, scip.LASER_ON)
        transport.write(request.packet())
        size = len(scip_scan.encode(np.zeros(request.count), request, 0))
        limits = (found.range_min, found.range_max)
        return Stream(decoder, 60.0 / found.speed, size, limits, whole_packets=True)


def _ask(transport: Transport, command: bytes) -> Reply:
    """The reply to a command; raises NoAnswerError."""
    reader = ReplyReader()

    def take(data: bytes) -> Reply | None:
        return next((reply for reply in reader.feed(data) if reply.echo == command.rstrip()), None)

    for _ in range(TRIES):
        transport.write(command)
        if found := await_answer(transport, take, ANSWER_TIMEOUT):
            return found[0]
    raise NoAnswerError(transport.name, "no lidar that speaks SCIP answers here")


def _field(reply: Reply, name: str) -> str:
    """A field of a reply with lines such as `SERI:H0906091;`; empty where it is not there."""
    for line in reply.lines:
        text = scip.verified(line)
        if text is not None and text.startswith(name.encode() + b":"):
            return text.decode("ascii", errors="replace").partition(":")[2].rstrip(";")
    return ""

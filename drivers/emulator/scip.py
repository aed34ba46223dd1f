"""An emulated Hokuyo URG-04LX, speaking SCIP 2.0 over its own USB: the baud rate does not matter."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from ..lidars import scip_scan
from ..lidars.scip import OK, Measure, Parameters, Reply, checksum, encode_values
from ..messages import Floats
from .device import Device
from .line import Line
from .optics import Optics

URG = Parameters("URG-04LX(Hokuyo Automatic Co.,Ltd.)", 0.02, 5.6, 1024, 44, 725, 384, 600.0)
IDENTITY = ("VEND:Hokuyo Automatic Co.,Ltd.", "PROD:SOKUIKI Sensor URG-04LX", "FIRM:3.3.00", "PROT:SCIP 2.0", "SERI:H0")
STATE = ("MODL:URG-04LX", "LASR:OFF", "SCSP:600", "MESM:IDLE", "SBPS:USB", "STAT:sensor is working normally")
UNKNOWN, WRONG_STEPS = "0E", "04"
"""Status of what is not understood, and of steps that there are not."""
LONGEST = 64
"""Bytes in a command; what is longer is none."""
MEASURE = re.compile(rb"([MG])([DS])(\d{4})(\d{4})(\d{2})(?:(\d)(\d{2}))?")


@dataclass(slots=True)
class _Task:
    """Measurements that were asked for: the revolution to look at next, and how many scans remain; None: no end."""

    request: Measure
    revolution: int
    remaining: int | None


class Scip(Device):
    """Its head turns counter-clockwise; step 0 of revolution k is measured at k turns' time on its own clock."""

    def __init__(self, name: str, line: Line, drift: float, optics: Optics) -> None:
        super().__init__(name, line, drift, usb_powered=True)
        self._optics = optics
        self._held = b""
        self._skipped = 0
        self._task: _Task | None = None
        self.scans = 0

    def switch_on(self, time: float) -> None:
        """Wait for commands."""
        super().switch_on(time)
        self._held, self._task = b"", None

    def port_opened(self, time: float) -> None:
        """It does not notice."""

    @property
    def misheard(self) -> int:
        """Bytes of lines that were no command."""
        return self._skipped

    def hear(self, data: bytes, time: float) -> None:
        """Obey and answer."""
        *lines, self._held = (self._held + data).replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if line:
                self._obey(line, time)
        if len(self._held) > LONGEST:
            self._skipped += len(self._held)
            self._held = b""

    def _obey(self, line: bytes, time: float) -> None:
        match = MEASURE.fullmatch(line)
        texts: dict[bytes, tuple[bytes, ...]] = {
            **dict.fromkeys((b"BM", b"SCIP2.0", b"TM0", b"TM2", b"QT", b"RS"), ()),
            b"VV": _sealed(IDENTITY),
            b"II": _sealed(STATE),
            b"PP": URG.lines(),
        }
        if match is not None and (match[1] == b"M") == (match[6] is not None):
            self._begin(line, match, time)
            return
        if line in (b"QT", b"RS"):
            self._task = None
        if line == b"TM1":
            clock = encode_values(np.array([self._clock(self.own(time))]), 4)
            reply = Reply(line, OK, (clock + checksum(clock),), 0)
        elif line in texts:
            reply = Reply(line, OK, texts[line], 0)
        elif re.fullmatch(rb"SS\d{6}", line):
            reply = Reply(line, OK, (), 0)
        else:
            self._skipped += len(line) + 1
            self.line.send(Reply(line[:LONGEST], UNKNOWN, (), 0).packet(), time)
            return
        self.requests += 1
        self.line.send(reply.packet(), time)

    def _begin(self, line: bytes, match: re.Match[bytes], time: float) -> None:
        """Take on a request for measurements."""
        first, last, cluster = (int(match[i]) for i in (3, 4, 5))
        continuous = match[1] == b"M"
        width = 3 if match[2] == b"D" else 2
        request = Measure(first, last, max(cluster, 1), continuous, width, int(match[6] or 0))
        self.requests += 1
        if not URG.first <= first <= last <= URG.last:
            self.line.send(Reply(line, WRONG_STEPS, (), 0).packet(), time)
            return
        revolution = math.ceil(self.own(time) * URG.speed / 60.0)
        wanted = int(match[7] or 0) or None
        self._task = _Task(request, revolution, wanted if continuous else 1)
        if continuous:
            self.line.send(Reply(line, OK, (), 0).packet(), time)

    @property
    def due(self) -> float:
        """When the next scan is complete."""
        if self._task is None or not self.on:
            return math.inf
        return self.host(float(self._own(self._task, np.array([self._task.request.last]))[0]))

    def _own(self, task: _Task, steps: Floats) -> Floats:
        """Own times at which steps (n,) are measured."""
        return np.asarray(task.revolution * 60.0 / URG.speed + steps * URG.step_period)

    def advance(self, time: float) -> None:
        """Measure and send what is due."""
        while (task := self._task) is not None and time >= self.due:
            self._scan(task)

    def _scan(self, task: _Task) -> None:
        request, ready = task.request, self.due
        steps = np.arange(request.first, request.last + 1, dtype=np.float64)
        own = self._own(task, steps)
        ranges = self._optics.measure(self.host(own), (steps - URG.front) * (2.0 * np.pi / URG.steps))
        padded = np.full(request.count * request.cluster, np.inf)
        padded[: len(ranges)] = np.where(np.isnan(ranges), np.inf, ranges)
        nearest = padded.reshape(request.count, -1).min(axis=1)
        if task.remaining is not None:
            task.remaining -= 1
        told = np.where(np.isfinite(nearest), nearest, np.nan)
        self.line.send(scip_scan.encode(told, request, self._clock(float(own[-1])), task.remaining or 0), ready)
        self.scans += 1
        task.revolution += 1 + request.skip
        if task.remaining == 0:
            self._task = None

    def _clock(self, own: float) -> int:
        """Milliseconds as it tells them."""
        return round(own * 1e3) % scip_scan.CLOCK_WRAP

    def report(self) -> dict[str, object]:
        """Scans sent."""
        return {"scans": self.scans}


def _sealed(texts: tuple[str, ...]) -> tuple[bytes, ...]:
    """Lines of text with their checksums."""
    return tuple(text.encode("ascii") + b";" + checksum(text.encode("ascii")) for text in texts)

"""An emulated Hokuyo URG-04LX with SCIP 2.0 over native USB: the baud rate does not matter."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from ..lidars import scip_scan
from ..lidars.scip import OK, MeasureRequest, Parameters, Reply, checksum, encode_text_lines, encode_values
from ..messages import Floats
from .beam_model import BeamModel
from .device import EmulatedDevice
from .serial_line import SerialLine

URG = Parameters("URG-04LX(Hokuyo Automatic Co.,Ltd.)", 0.02, 5.6, 1024, 44, 725, 384, 600.0)
IDENTITY = ("VEND:Hokuyo Automatic Co.,Ltd.", "PROD:SOKUIKI Sensor URG-04LX", "FIRM:3.3.00", "PROT:SCIP 2.0", "SERI:H0")
UNKNOWN, WRONG_STEPS = "0E", "04"
"""Status of an unknown command, and of invalid steps."""
MAX_COMMAND_LENGTH = 64
"""Bytes; longer commands are invalid."""
MEASURE_PATTERN = re.compile(rb"([MG])([DS])(\d{4})(\d{4})(\d{2})(?:(\d)(\d{2}))?")


@dataclass(slots=True)
class _MeasurementTask:
    """A measurement request in progress: the next revolution to measure, and the number of remaining scans; None if
    unlimited.
    """

    request: MeasureRequest
    revolution: int
    remaining: int | None


class EmulatedScip(EmulatedDevice):
    """A URG-04LX. Its head turns counter-clockwise; step 0 of revolution k is measured after k turns of its clock."""

    def __init__(self, name: str, line: SerialLine, drift: float, beams: BeamModel) -> None:
        super().__init__(name, line, drift, usb_powered=True)
        self._beams = beams
        self._held = b""
        self._bytes_skipped = 0
        self._task: _MeasurementTask | None = None
        self.scans = 0

    def switch_on(self, time: float) -> None:
        """Wait for commands."""
        super().switch_on(time)
        self._held, self._task = b"", None

    def on_port_opened(self, time: float) -> None:
        """Do nothing: the device does not notice."""

    @property
    def unrecognised(self) -> int:
        """Bytes of lines that were no command."""
        return self._bytes_skipped

    def receive(self, data: bytes, time: float) -> None:
        """Execute the commands and reply."""
        *lines, self._held = (self._held + data).replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if line:
                self._execute(line, time)
        if len(self._held) > MAX_COMMAND_LENGTH:
            self._bytes_skipped += len(self._held)
            self._held = b""

    def _execute(self, line: bytes, time: float) -> None:
        match = MEASURE_PATTERN.fullmatch(line)
        texts: dict[bytes, tuple[bytes, ...]] = {
            **dict.fromkeys((b"BM", b"SCIP2.0", b"TM0", b"TM2", b"QT", b"RS"), ()),
            b"VV": encode_text_lines(IDENTITY),
            b"II": encode_text_lines(self._state(time)),
            b"PP": URG.lines(),
        }
        if match is not None and (match[1] == b"M") == (match[6] is not None):
            self._start_measuring(line, match, time)
            return
        if line in (b"QT", b"RS"):
            self._task = None
        if line == b"TM1":
            clock = encode_values(np.array([self._clock(self.to_device_time(time))]), 4)
            reply = Reply(line, OK, (clock + checksum(clock),), 0)
        elif line in texts:
            reply = Reply(line, OK, texts[line], 0)
        elif re.fullmatch(rb"SS\d{6}", line):
            reply = Reply(line, OK, (), 0)
        else:
            self._bytes_skipped += len(line) + 1
            self.line.send(Reply(line[:MAX_COMMAND_LENGTH], UNKNOWN, (), 0).packet(), time)
            return
        self.requests += 1
        self.line.send(reply.packet(), time)

    def _state(self, time: float) -> tuple[str, ...]:
        """Return the lines of state and condition."""
        measuring = self._task is not None
        return (
            "MODL:URG-04LX",
            f"LASR:{'ON' if measuring else 'OFF'}",
            f"SCSP:{round(URG.speed)}",
            f"MESM:{'Measuring by Normal Mode' if measuring else 'Idle'}",
            "SBPS:USB",
            f"TIME:{self._clock(self.to_device_time(time)):06X}",
            "STAT:sensor is working normally",
        )

    def _start_measuring(self, line: bytes, match: re.Match[bytes], time: float) -> None:
        """Start a measurement request."""
        first, last, cluster = (int(match[i]) for i in (3, 4, 5))
        continuous = match[1] == b"M"
        width = 3 if match[2] == b"D" else 2
        request = MeasureRequest(first, last, max(cluster, 1), continuous, width, int(match[6] or 0))
        self.requests += 1
        if not URG.first <= first <= last <= URG.last:
            self.line.send(Reply(line, WRONG_STEPS, (), 0).packet(), time)
            return
        revolution = math.ceil(self.to_device_time(time) * URG.speed / 60.0)
        wanted = int(match[7] or 0) or None
        self._task = _MeasurementTask(request, revolution, wanted if continuous else 1)
        if continuous:
            self.line.send(Reply(line, OK, (), 0).packet(), time)

    @property
    def due(self) -> float:
        """Time at which the next scan is complete."""
        if self._task is None or not self.on:
            return math.inf
        return self.to_host_time(float(self._device_times(self._task, np.array([self._task.request.last]))[0]))

    def _device_times(self, task: _MeasurementTask, steps: Floats) -> Floats:
        """Return the device times at which steps (n,) are measured."""
        return np.asarray(task.revolution * 60.0 / URG.speed + steps * URG.step_period)

    def advance(self, time: float) -> None:
        """Measure and send all scans that are due."""
        while (task := self._task) is not None and time >= self.due:
            self._scan(task)

    def _scan(self, task: _MeasurementTask) -> None:
        request, ready = task.request, self.due
        steps = np.arange(request.first, request.last + 1, dtype=np.float64)
        device_time = self._device_times(task, steps)
        ranges = self._beams.measure(self.to_host_time(device_time), (steps - URG.front) * (2.0 * np.pi / URG.steps))
        padded = np.full(request.count * request.cluster, np.inf)
        padded[: len(ranges)] = np.where(np.isnan(ranges), np.inf, ranges)
        nearest = padded.reshape(request.count, -1).min(axis=1)
        if task.remaining is not None:
            task.remaining -= 1
        reported = np.where(np.isfinite(nearest), nearest, np.nan)
        self.line.send(
            scip_scan.encode(reported, request, self._clock(float(device_time[-1])), task.remaining or 0), ready
        )
        self.scans += 1
        task.revolution += 1 + request.skip
        if task.remaining == 0:
            self._task = None

    def _clock(self, device_time: float) -> int:
        """Return the milliseconds that the device reports."""
        return round(device_time * 1e3) % scip_scan.CLOCK_WRAP

    def report(self) -> dict[str, object]:
        """Return the number of scans sent."""
        return {"scans": self.scans}

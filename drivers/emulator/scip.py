"""Emulated Hokuyo lidars with SCIP 2.0 over native USB, where the baud rate does not matter.

The URG-04LX measures ranges only. The UTM-30LX-EW also measures intensities, and two echoes of a beam at an edge.
"""

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
UTM = Parameters("UTM-30LX-EW", 0.023, 60.0, 1440, 0, 1080, 540, 2400.0)
SCIP_VARIANTS = {"scip": URG, "scip-utm": UTM}
"""Lidars by the name that a user gives."""
INTENSITY = 4000.0
"""Intensity at one metre; it decreases in proportion to the range."""
EDGE = 0.1
"""Metres between the ranges of neighbouring steps above which a beam between them returns two echoes."""
UNKNOWN, WRONG_STEPS = "0E", "04"
"""Status of an unknown command, and of invalid steps."""
MAX_COMMAND_LENGTH = 64
"""Bytes; longer commands are invalid."""
MEASURE_PATTERN = re.compile(rb"([MGNH])([DSE])(\d{4})(\d{4})(\d{2})(?:(\d)(\d{2}))?")


@dataclass(slots=True)
class _MeasurementTask:
    """A measurement request in progress: the next revolution to measure, and the number of remaining scans; None if
    unlimited.
    """

    request: MeasureRequest
    revolution: int
    remaining: int | None


class EmulatedScip(EmulatedDevice):
    """One of SCIP_VARIANTS. Its head turns counter-clockwise; step 0 of revolution k is measured after k turns of its
    clock.
    """

    def __init__(self, name: str, line: SerialLine, drift: float, beams: BeamModel, model: Parameters) -> None:
        super().__init__(name, line, drift, usb_powered=True)
        self.model = model
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
            b"VV": encode_text_lines(self._identity),
            b"II": encode_text_lines(self._state(time)),
            b"PP": self.model.lines(),
        }
        if match is not None and (match[1] in b"MN") == (match[6] is not None):
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

    @property
    def _product(self) -> str:
        """Name of the model without that of its maker."""
        return self.model.model.partition("(")[0]

    @property
    def _identity(self) -> tuple[str, ...]:
        """Lines of the reply to VV."""
        product = f"PROD:SOKUIKI Sensor {self._product}"
        return ("VEND:Hokuyo Automatic Co.,Ltd.", product, "FIRM:3.3.00", "PROT:SCIP 2.0", "SERI:H0")

    def _state(self, time: float) -> tuple[str, ...]:
        """Return the lines of state and condition."""
        measuring = self._task is not None
        return (
            f"MODL:{self._product}",
            f"LASR:{'ON' if measuring else 'OFF'}",
            f"SCSP:{round(self.model.speed)}",
            f"MESM:{'Measuring by Normal Mode' if measuring else 'Idle'}",
            "SBPS:USB",
            f"TIME:{self._clock(self.to_device_time(time)):06X}",
            "STAT:sensor is working normally",
        )

    def _start_measuring(self, line: bytes, match: re.Match[bytes], time: float) -> None:
        """Start a measurement request."""
        first, last, cluster = (int(match[i]) for i in (3, 4, 5))
        continuous, echoes, intensity = match[1] in b"MN", match[1] in b"NH", match[2] == b"E"
        width, skip = 2 if match[2] == b"S" else 3, int(match[6] or 0)
        if ((echoes or intensity) and self.model is URG) or (echoes and width == 2):
            self.line.send(Reply(line, UNKNOWN, (), 0).packet(), time)
            return
        request = MeasureRequest(first, last, max(cluster, 1), continuous, width, skip, intensity, echoes)
        self.requests += 1
        if not self.model.first <= first <= last <= self.model.last:
            self.line.send(Reply(line, WRONG_STEPS, (), 0).packet(), time)
            return
        revolution = math.ceil(self.to_device_time(time) * self.model.speed / 60.0)
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
        return np.asarray(task.revolution * 60.0 / self.model.speed + steps * self.model.step_period)

    def advance(self, time: float) -> None:
        """Measure and send all scans that are due."""
        while (task := self._task) is not None and time >= self.due:
            self._scan(task)

    def _scan(self, task: _MeasurementTask) -> None:
        request, ready = task.request, self.due
        steps = np.arange(request.first, request.last + 1, dtype=np.float64)
        device_time = self._device_times(task, steps)
        ranges = self._beams.measure(
            self.to_host_time(device_time), (steps - self.model.front) * (2.0 * np.pi / self.model.steps)
        )
        if task.remaining is not None:
            task.remaining -= 1
        reported, behind = _nearest(ranges, request), None
        if request.echoes:
            ranges, farther = _echoes(ranges)
            reported, behind = _nearest(ranges, request), _nearest(farther, request)
        clock, remaining = self._clock(float(device_time[-1])), task.remaining or 0
        intensities = np.nan_to_num(INTENSITY / reported)
        self.line.send(
            scip_scan.encode(reported, request, clock, remaining, intensities=intensities, behind=behind), ready
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


def _nearest(ranges: Floats, request: MeasureRequest) -> Floats:
    """Return the nearest of the ranges of each cluster of a request, NaN if there is none."""
    padded = np.full(request.count * request.cluster, np.inf)
    padded[: len(ranges)] = np.where(np.isnan(ranges), np.inf, ranges)
    nearest = padded.reshape(request.count, -1).min(axis=1)
    return np.where(np.isfinite(nearest), nearest, np.nan)


def _echoes(ranges: Floats) -> tuple[Floats, Floats]:
    """Return the first and the second echo (n,) of beams that are wide enough to hit what the next step hits."""
    following = np.append(ranges[1:], np.nan)
    near, far = np.fmin(ranges, following), np.fmax(ranges, following)
    at_edge = np.abs(following - ranges) > EDGE
    return np.where(at_edge, near, ranges), np.where(at_edge, far, np.nan)

"""An emulated RPLIDAR: responds like the device, and scans in the requested mode."""

from __future__ import annotations

import math
import struct

import numpy as np

from ..lidars.rplidar.decoding import descriptor_of
from ..lidars.rplidar.models import DEFAULT_PWM, Motor
from ..lidars.rplidar.modes import ROTATION_LIMITS, ScanMode, configuration_response
from ..lidars.rplidar.requests import Command, Request, RequestReader
from ..lidars.rplidar.responses import Descriptor, Health, HealthStatus, ResponseType
from ..messages import Floats
from .beam_model import BeamModel
from .device import EmulatedDevice
from .rplidar_scan import ScanInProgress, beam_lag, encode, quantised_beam_lag
from .rplidar_variants import RplidarVariant
from .serial_line import SerialLine

BOOT_DURATION = 0.5
"""Seconds from power-up or reset until it listens and sends the banner."""
SPIN_UP_DURATION = 1.0
"""Seconds until the head turns steadily; there are no measurements before."""
SCAN_START_DELAY = 0.01
"""Seconds from the scan request to the first sample."""
SPEED_VARIATION, SPEED_VARIATION_PERIOD = 0.005, 7.0
"""Relative amplitude and period (seconds) of the variation of the head's speed."""
ERROR_CODE = 4
"""Code of the internal error; Slamtec documents none."""
COMMANDS_WHILE_SCANNING = frozenset(
    {
        *(Command.STOP, Command.RESET, Command.SCAN, Command.FORCE_SCAN, Command.EXPRESS_SCAN, Command.HQ_SCAN),
        *(Command.SET_MOTOR_SPEED, Command.SET_MOTOR_PWM),
    }
)
"""Commands accepted during a scan; other requests get no response."""


class EmulatedRplidar(EmulatedDevice):
    """One of `rplidar_variants`. Its modem line DTR is never asserted, as pseudo terminals have none."""

    def __init__(self, name: str, line: SerialLine, drift: float, kind: RplidarVariant, beams: BeamModel) -> None:
        super().__init__(name, line, drift, usb_powered=True)
        self.kind, self._beams = kind, beams
        self._reader = RequestReader()
        self._scan: ScanInProgress | None = None
        self._failed = False
        self._booting = False
        self._turning_since: float | None = None  # device time since which the head turns; None if it stands still
        self._rate = kind.rate
        self._phase = (0.0, 0.0)  # the head's angle at a device time, from which on it turns at _rate
        self.scans = self.samples = 0

    # -- power ------------------------------------------------------------------------------------------------------

    def switch_on(self, time: float) -> None:
        """Boot; the banner follows at the end."""
        super().switch_on(time)
        self._scan, self._failed, self._booting = None, False, True
        self._reader = self._new_reader()
        self._rate, self._phase = self.kind.rate, (0.0, 0.0)
        self._turning_since = 0.0 if self.kind.model.motor is Motor.DTR else None

    def _new_reader(self) -> RequestReader:
        reader = RequestReader()
        reader.bytes_skipped = self._reader.bytes_skipped
        return reader

    def on_port_opened(self, time: float) -> None:
        """Do nothing: the device does not notice."""

    def inject_error(self, time: float) -> bool:
        """Enter the protection state, in which health is an error and nothing is measured, until a reset."""
        self._failed, self._scan = True, None
        return True

    def _banner(self) -> bytes:
        info = self.kind.info
        text = f"RP LIDAR System.\r\nFirmware Ver {info.firmware[0]}.{info.firmware[1]:02d}, HW Ver {info.hardware}\r\n"
        return f"{text}Model: {info.model:02x}\r\n".encode("ascii")

    # -- requests ---------------------------------------------------------------------------------------------------

    @property
    def unrecognised(self) -> int:
        """Bytes that were no request."""
        return self._reader.bytes_skipped

    def receive(self, data: bytes, time: float) -> None:
        """Execute the requests and respond; ignore them while booting."""
        if not self.on or self.to_device_time(time) < BOOT_DURATION:
            return
        for request in self._reader.feed(data):
            if self._booting:
                return  # requests after a reset are lost
            self.requests += 1
            if self._scan is None or request.command in COMMANDS_WHILE_SCANNING:
                self._execute(request, time)

    def _execute(self, request: Request, time: float) -> None:
        command, kind = request.command, self.kind
        if command == Command.STOP:
            self._stop_scan()
        elif command == Command.RESET:
            self.switch_off()
            self.switch_on(time)
        elif command in (Command.SCAN, Command.FORCE_SCAN):
            self._start(ResponseType.STANDARD, kind.modes.modes[0].sample_period, time)
        elif command == Command.HQ_SCAN:
            self._start_mode(
                next((mode for mode in kind.modes.modes if mode.response_type == ResponseType.HQ), None), time
            )
        elif command == Command.EXPRESS_SCAN and len(request.payload) == 5:
            self._start_mode(self._find_express_mode(request.payload[0]), time)
        elif command == Command.SET_MOTOR_SPEED and len(request.payload) == 2 and kind.model.motor is Motor.SPEED:
            self._set_motor(struct.unpack("<H", request.payload)[0] / 60.0, time)
        elif command == Command.SET_MOTOR_PWM and len(request.payload) == 2 and kind.model.motor is Motor.PWM:
            self._set_motor(kind.rate * struct.unpack("<H", request.payload)[0] / DEFAULT_PWM, time)
        else:
            self._respond(request, time)

    def _respond(self, request: Request, time: float) -> None:
        """Send a single response."""
        command, kind = request.command, self.kind
        health = Health(HealthStatus.ERROR, ERROR_CODE) if self._failed else Health(HealthStatus.GOOD, 0)
        responses: dict[int, tuple[ResponseType, bytes | None]] = {
            Command.GET_INFO: (ResponseType.INFO, kind.info.payload()),
            Command.GET_HEALTH: (ResponseType.HEALTH, health.payload()),
            Command.GET_SAMPLE_RATE: (ResponseType.SAMPLE_RATE, kind.sample_rate.payload()),
        }
        if kind.model.motor is Motor.PWM:
            responses[Command.GET_MOTOR_BOARD] = (ResponseType.MOTOR_BOARD, struct.pack("<I", 1))
        if kind.reports_modes:
            rotation = (round(60 * kind.rate), DEFAULT_PWM)
            responses[Command.GET_CONFIGURATION] = (
                ResponseType.CONFIGURATION,
                configuration_response(request, kind.modes, rotation),
            )
        response_type, payload = responses.get(command, (ResponseType.INFO, None))
        if payload is not None:
            self.line.send(Descriptor(len(payload), False, response_type).packet() + payload, time)

    # -- motor and scans --------------------------------------------------------------------------------------------

    def _find_express_mode(self, number: int) -> ScanMode | None:
        """Return the mode that a request for capsules selects."""
        modes = self.kind.modes.modes
        if self.kind.reports_modes:
            return next((mode for mode in modes if mode.id == number), None)
        return modes[1] if number == 0 else None

    def _start_mode(self, mode: ScanMode | None, time: float) -> None:
        if mode is not None:
            self._start(mode.response_type, mode.sample_period, time)

    def _start(self, response_type: int, period: float, time: float) -> None:
        if self._failed:
            return
        device_time = self.to_device_time(time)
        if self._turning_since is None and self.kind.model.motor in (Motor.SPEED, Motor.SCAN):
            self._turning_since = device_time
        nothing = np.empty(0)
        start = (
            math.inf
            if self._turning_since is None
            else max(device_time + SCAN_START_DELAY, self._turning_since + SPIN_UP_DURATION)
        )
        self._scan = ScanInProgress(response_type, period, start, 0, nothing, nothing, nothing)
        self.scans += 1
        self.line.send(descriptor_of(response_type).packet(), time)

    def _stop_scan(self) -> None:
        self._scan = None
        if self.kind.model.motor is Motor.SCAN:
            self._turning_since = None

    def _set_motor(self, rate: float, time: float) -> None:
        """Set the rotation rate in revolutions per second, within the limits that the device reports.

        A motor started by the scan does not stop before the scan has ended.
        """
        device_time = self.to_device_time(time)
        if rate > 0.0:
            self._phase = (float(self._head(np.array([device_time]))[0]), device_time)
            low, high = (limit / 60.0 for limit in ROTATION_LIMITS.values())
            self._rate = min(max(rate, low), high)
            if self._turning_since is None:
                self._turning_since = device_time
                if self._scan is not None:
                    self._scan.start = device_time + SPIN_UP_DURATION
        elif self._scan is None or self.kind.model.motor is Motor.PWM:
            self._turning_since = None
            if self._scan is not None:
                self._scan.start = math.inf

    def _head(self, device_time: Floats) -> Floats:
        """Return the radians clockwise that the head has turned at device times (n,)."""
        angle, since = self._phase
        slow = 2.0 * np.pi / SPEED_VARIATION_PERIOD
        gained = SPEED_VARIATION / slow * (np.cos(slow * since) - np.cos(slow * device_time))
        return np.asarray(angle + 2.0 * np.pi * self._rate * (device_time - since + gained))

    # -- measuring --------------------------------------------------------------------------------------------------

    @property
    def due(self) -> float:
        """Time of the banner or the next packet."""
        if not self.on:
            return math.inf
        if self._booting:
            return self.to_host_time(BOOT_DURATION)
        scan = self._scan
        if scan is None or scan.start == math.inf:
            return math.inf
        return self.to_host_time(scan.start + (scan.samples + self._samples_due(scan)) * scan.period)

    def _samples_due(self, scan: ScanInProgress) -> int:
        """Return the number of samples to measure next; one more the first time, as packets may refer to their
        successor.
        """
        return scan.in_packet + (scan.samples == 0)

    def advance(self, time: float) -> None:
        """Measure and send everything that is due."""
        if self._booting and self.on and time >= self.to_host_time(BOOT_DURATION):
            self._booting = False
            self.line.send(self._banner(), self.to_host_time(BOOT_DURATION))
        while (scan := self._scan) is not None and time >= self.due:
            self._measure(scan, self._samples_due(scan))
            self._send(scan)

    def _measure(self, scan: ScanInProgress, count: int) -> None:
        device_time = scan.start + np.arange(scan.samples, scan.samples + count, dtype=np.float64) * scan.period
        heads, times = self._head(device_time), self.to_host_time(device_time)
        if self.kind.model.triangulates:
            ranges, lags = self._beams.measure_with_lag(
                times, heads, quantised_beam_lag if scan.response_type == ResponseType.EXPRESS else beam_lag
            )
        else:
            ranges, lags = self._beams.measure(times, -heads), np.zeros(count)
        scan.heads = np.concatenate([scan.heads, heads])
        scan.lags = np.concatenate([scan.lags, lags])
        scan.ranges = np.concatenate([scan.ranges, ranges])
        scan.samples += count
        self.samples += count

    def _send(self, scan: ScanInProgress) -> None:
        """Send all measured samples except one."""
        count = scan.in_packet
        heads, ranges, lags = scan.heads[:count], scan.ranges[:count], scan.lags[:count]
        turns = np.floor(np.concatenate([[scan.before or heads[0]], heads]) / (2.0 * np.pi))
        data = encode(scan, heads, ranges, lags, np.diff(turns) > 0)
        last = scan.start + (scan.samples - 2) * scan.period  # of the packet's samples
        ready = last + 1.5 * scan.period  # a sample takes its period, and half a period of filtering
        if scan.response_type == ResponseType.STANDARD:
            self.line.send(
                data, self.to_host_time(ready - scan.period * np.arange(count - 1, -1, -1, dtype=np.float64))
            )
        else:
            self.line.send(data, self.to_host_time(ready))
        scan.heads, scan.lags, scan.ranges = scan.heads[count:], scan.lags[count:], scan.ranges[count:]
        scan.before = float(heads[-1])
        scan.packets += 1

    def report(self) -> dict[str, object]:
        """Return the numbers of scans started and samples measured."""
        return {"scans": self.scans, "samples": self.samples}

"""An emulated RPLIDAR: answers as the device does, and scans in the mode that it was told."""

from __future__ import annotations

import math
import struct

import numpy as np

from ..lidars.rplidar.answers import Answer, Descriptor, Health, Status
from ..lidars.rplidar.decoding import descriptor_of
from ..lidars.rplidar.models import DEFAULT_PWM, Motor
from ..lidars.rplidar.modes import ScanMode, answer_to
from ..lidars.rplidar.requests import Command, Request, RequestReader
from ..messages import Floats
from .device import Device
from .line import Line
from .optics import Optics
from .rplidar_kinds import Kind
from .rplidar_scan import Scanning, encode, lag_in_eighths, lag_of

BOOT = 0.5
"""Seconds from power or reset until it listens; the banner comes then."""
SPIN_UP = 1.0
"""Seconds until the head turns steadily; there are no measurements before."""
START = 0.01
"""Seconds from the request for a scan to its first sample."""
WOBBLE, WOBBLE_PERIOD = 0.005, 7.0
"""The head is faster and slower by this share, in so many seconds."""
FAILURE = 4
"""Code of an inner error; Slamtec documents none."""
WHILE_SCANNING = frozenset(
    {
        *(Command.STOP, Command.RESET, Command.SCAN, Command.FORCE_SCAN, Command.EXPRESS_SCAN, Command.HQ_SCAN),
        *(Command.SET_MOTOR_SPEED, Command.SET_MOTOR_PWM),
    }
)
"""What is heeded then; other requests get no answer."""


class Rplidar(Device):
    """One of `rplidar_kinds`. Its DTR line is never asserted, as pseudo terminals have none."""

    def __init__(self, name: str, line: Line, drift: float, kind: Kind, optics: Optics) -> None:
        super().__init__(name, line, drift, usb_powered=True)
        self.kind, self._optics = kind, optics
        self._reader = RequestReader()
        self._scan: Scanning | None = None
        self._failed = False
        self._booting = False
        self._turning: float | None = None  # own time since which the head turns; None: it stands
        self._rate = kind.rate
        self._phase = (0.0, 0.0)  # the head's angle at an own time; it turns at _rate from there
        self.scans = self.samples = 0

    # -- power ------------------------------------------------------------------------------------------------------

    def switch_on(self, time: float) -> None:
        """Boot; the banner follows when it is done."""
        super().switch_on(time)
        self._scan, self._failed, self._booting = None, False, True
        self._reader = self._fresh_reader()
        self._rate, self._phase = self.kind.rate, (0.0, 0.0)
        self._turning = 0.0 if self.kind.model.motor is Motor.DTR else None

    def _fresh_reader(self) -> RequestReader:
        reader = RequestReader()
        reader.bytes_skipped = self._reader.bytes_skipped
        return reader

    def port_opened(self, time: float) -> None:
        """It does not notice."""

    def fail(self, time: float) -> bool:
        """Go into the state of protection, where health is an error and nothing is measured, until a reset."""
        self._failed, self._scan = True, None
        return True

    def _banner(self) -> bytes:
        info = self.kind.info
        text = f"RP LIDAR System.\r\nFirmware Ver {info.firmware[0]}.{info.firmware[1]:02d}, HW Ver {info.hardware}\r\n"
        return f"{text}Model: {info.model:02x}\r\n".encode("ascii")

    # -- requests ---------------------------------------------------------------------------------------------------

    @property
    def misheard(self) -> int:
        """Bytes that were no request."""
        return self._reader.bytes_skipped

    def hear(self, data: bytes, time: float) -> None:
        """Obey and answer; deaf while it boots."""
        if not self.on or self.own(time) < BOOT:
            return
        for request in self._reader.feed(data):
            if self._booting:
                return  # what came after a reset went unheard
            self.requests += 1
            if self._scan is None or request.command in WHILE_SCANNING:
                self._obey(request, time)

    def _obey(self, request: Request, time: float) -> None:
        command, kind = request.command, self.kind
        if command == Command.STOP:
            self._stop_scan()
        elif command == Command.RESET:
            self.switch_off()
            self.switch_on(time)
        elif command in (Command.SCAN, Command.FORCE_SCAN):
            self._start(Answer.STANDARD, kind.modes.modes[0].sample_period, time)
        elif command == Command.HQ_SCAN:
            self._start_mode(next((mode for mode in kind.modes.modes if mode.answer == Answer.HQ), None), time)
        elif command == Command.EXPRESS_SCAN and len(request.payload) == 5:
            self._start_mode(self._express_mode(request.payload[0]), time)
        elif command == Command.SET_MOTOR_SPEED and len(request.payload) == 2 and kind.model.motor is Motor.SPEED:
            self._set_motor(struct.unpack("<H", request.payload)[0] / 60.0, time)
        elif command == Command.SET_MOTOR_PWM and len(request.payload) == 2 and kind.model.motor is Motor.PWM:
            self._set_motor(kind.rate * struct.unpack("<H", request.payload)[0] / DEFAULT_PWM, time)
        else:
            self._answer(request, time)

    def _answer(self, request: Request, time: float) -> None:
        """What is answered once."""
        command, kind = request.command, self.kind
        health = Health(Status.ERROR, FAILURE) if self._failed else Health(Status.GOOD, 0)
        answers: dict[int, tuple[Answer, bytes | None]] = {
            Command.GET_INFO: (Answer.INFO, kind.info.payload()),
            Command.GET_HEALTH: (Answer.HEALTH, health.payload()),
            Command.GET_SAMPLE_RATE: (Answer.SAMPLE_RATE, kind.sample_rate.payload()),
        }
        if kind.model.motor is Motor.PWM:
            answers[Command.GET_MOTOR_BOARD] = (Answer.MOTOR_BOARD, struct.pack("<I", 1))
        if kind.tells_modes:
            rotation = (round(60 * kind.rate), DEFAULT_PWM)
            answers[Command.GET_CONFIGURATION] = (Answer.CONFIGURATION, answer_to(request, kind.modes, rotation))
        answer, payload = answers.get(command, (Answer.INFO, None))
        if payload is not None:
            self.line.send(Descriptor(len(payload), False, answer).packet() + payload, time)

    # -- motor and scans --------------------------------------------------------------------------------------------

    def _express_mode(self, number: int) -> ScanMode | None:
        """The mode that a request for capsules means."""
        modes = self.kind.modes.modes
        if self.kind.tells_modes:
            return next((mode for mode in modes if mode.id == number), None)
        return modes[1] if number == 0 else None

    def _start_mode(self, mode: ScanMode | None, time: float) -> None:
        if mode is not None:
            self._start(mode.answer, mode.sample_period, time)

    def _start(self, answer: int, period: float, time: float) -> None:
        if self._failed:
            return
        own = self.own(time)
        if self._turning is None and self.kind.model.motor in (Motor.SPEED, Motor.SCAN):
            self._turning = own
        nothing = np.empty(0)
        begun = math.inf if self._turning is None else max(own + START, self._turning + SPIN_UP)
        self._scan = Scanning(answer, period, begun, 0, nothing, nothing, nothing)
        self.scans += 1
        self.line.send(descriptor_of(answer).packet(), time)

    def _stop_scan(self) -> None:
        self._scan = None
        if self.kind.model.motor is Motor.SCAN:
            self._turning = None

    def _set_motor(self, rate: float, time: float) -> None:
        """Turn at a rate, revolutions a second; a motor that the scan turns does not stop before that has ended."""
        own = self.own(time)
        if rate > 0.0:
            self._phase = (float(self._head(np.array([own]))[0]), own)
            self._rate = rate
            if self._turning is None:
                self._turning = own
                if self._scan is not None:
                    self._scan.begun = own + SPIN_UP
        elif self._scan is None or self.kind.model.motor is Motor.PWM:
            self._turning = None
            if self._scan is not None:
                self._scan.begun = math.inf

    def _head(self, own: Floats) -> Floats:
        """Radians clockwise that the head has turned at own times (n,)."""
        angle, since = self._phase
        slow = 2.0 * np.pi / WOBBLE_PERIOD
        gained = WOBBLE / slow * (np.cos(slow * since) - np.cos(slow * own))
        return np.asarray(angle + 2.0 * np.pi * self._rate * (own - since + gained))

    # -- measuring --------------------------------------------------------------------------------------------------

    @property
    def due(self) -> float:
        """When the banner or the next packet is."""
        if not self.on:
            return math.inf
        if self._booting:
            return self.host(BOOT)
        scan = self._scan
        if scan is None or scan.begun == math.inf:
            return math.inf
        return self.host(scan.begun + (scan.samples + self._wanted(scan)) * scan.period)

    def _wanted(self, scan: Scanning) -> int:
        """Samples to measure next; the first time one more, as a packet may tell how the next begins."""
        return scan.in_packet + (scan.samples == 0)

    def advance(self, time: float) -> None:
        """Measure what is due, and send it."""
        if self._booting and self.on and time >= self.host(BOOT):
            self._booting = False
            self.line.send(self._banner(), self.host(BOOT))
        while (scan := self._scan) is not None and time >= self.due:
            self._measure(scan, self._wanted(scan))
            self._send(scan)

    def _measure(self, scan: Scanning, count: int) -> None:
        own = scan.begun + np.arange(scan.samples, scan.samples + count, dtype=np.float64) * scan.period
        heads, times = self._head(own), self.host(own)
        if self.kind.model.corrected:
            ranges, lags = self._optics.measure_lagging(
                times, heads, lag_in_eighths if scan.answer == Answer.EXPRESS else lag_of
            )
        else:
            ranges, lags = self._optics.measure(times, -heads), np.zeros(count)
        scan.heads = np.concatenate([scan.heads, heads])
        scan.lags = np.concatenate([scan.lags, lags])
        scan.ranges = np.concatenate([scan.ranges, ranges])
        scan.samples += count
        self.samples += count

    def _send(self, scan: Scanning) -> None:
        """Send what is measured, but for one sample."""
        count = scan.in_packet
        heads, ranges, lags = scan.heads[:count], scan.ranges[:count], scan.lags[:count]
        turns = np.floor(np.concatenate([[scan.before or heads[0]], heads]) / (2.0 * np.pi))
        data = encode(scan, heads, ranges, lags, np.diff(turns) > 0)
        last = scan.begun + (scan.samples - 2) * scan.period  # of the packet
        ready = last + 1.5 * scan.period  # a sample takes its period, and is filtered for another half
        if scan.answer == Answer.STANDARD:
            self.line.send(data, self.host(ready - scan.period * np.arange(count - 1, -1, -1, dtype=np.float64)))
        else:
            self.line.send(data, self.host(ready))
        scan.heads, scan.lags, scan.ranges = scan.heads[count:], scan.lags[count:], scan.ranges[count:]
        scan.before = float(heads[-1])
        scan.packets += 1

    def report(self) -> dict[str, object]:
        """Scans started, samples measured."""
        return {"scans": self.scans, "samples": self.samples}

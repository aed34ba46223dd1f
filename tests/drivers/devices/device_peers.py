"""Emulated devices of every kind in a thread of the test, behind pseudo terminals.

A call of a device sends what was due at its beginning, so that it ends even if the computer is too slow for it.
"""

from __future__ import annotations

import math
import os
import pty
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from drivers import Odometry, Scan
from drivers.bases import (
    ArduinoBridgeDevice,
    Create2Device,
    DifferentialDrive,
    KobukiDevice,
    Poll,
    WheelLineDevice,
    WheelReading,
)
from drivers.lidars import ld06, scip, scip_scan
from drivers.lidars.rplidar import requests, standard
from drivers.lidars.rplidar.decoding import descriptor_of
from drivers.lidars.rplidar.requests import Command
from drivers.lidars.rplidar.responses import Descriptor, Health, HealthStatus, Info, ResponseType, SampleRate

WHEELS = "wheel_radius=0.05&ticks=1000&track=0.3"
URG = scip.Parameters("URG-04LX", 0.02, 5.6, 1024, 44, 725, 384, 600.0)

Behaviour = Callable[[bytes], bytes]
"""Returns the bytes that a device sends; called often with the received bytes."""


class Ld06Peer:
    def __init__(self) -> None:
        self.begun, self.packet = time.monotonic(), 0

    def __call__(self, received: bytes) -> bytes:
        sent = b""
        elapsed = time.monotonic() - self.begun
        while (self.packet + 1) * 12 / 4500 < elapsed:
            bearings = 2 * np.pi * 10.0 / 4500 * (self.packet * 12 + np.array([[0, 11]]))
            sent += ld06.encode(
                bearings, np.full((1, 12), 1.5), np.full((1, 12), 200), 20 * np.pi, self.packet * 12 / 4500
            )
            self.packet += 1
        return sent


class ScipPeer:
    """A lidar that is already streaming, and uses SCIP 1.1 at first."""

    def __init__(self) -> None:
        self.line = b""
        self.old, self.laser = True, False
        self.measure: scip.MeasureRequest | None = scip.MeasureRequest(0, 9)
        self.begun, self.scan = time.monotonic(), 0

    def __call__(self, received: bytes) -> bytes:
        sent = b""
        *lines, self.line = (self.line + received).split(b"\n")
        for line in filter(None, lines):
            sent += self.answer(line)
        elapsed = time.monotonic() - self.begun
        while self.measure and self.scan * 0.1 < elapsed:
            ranges = np.full(self.measure.count, 2.0)
            sent += scip_scan.encode(ranges, self.measure, round(self.scan * 100))
            self.scan += 1
        return sent

    def answer(self, line: bytes) -> bytes:
        lines: tuple[bytes, ...] = ()
        if line == b"SCIP2.0":
            self.old = False
        elif self.old and line != b"QT":
            return line + b"\nE\n\n"
        elif line == b"QT":
            self.measure, self.laser = None, False
        elif line == b"PP":
            lines = URG.lines()
        elif line == b"VV":
            lines = (b"SERI:H42;" + scip.checksum(b"SERI:H42"),)
        elif line == b"BM":
            self.laser = True
        elif line.startswith((b"MD", b"ME")) and self.laser:
            self.measure = scip.MeasureRequest(URG.first, URG.last, intensity=line.startswith(b"ME"))
            self.begun, self.scan = time.monotonic(), 0
        elif line.startswith(b"NE"):
            return scip.Reply(line, "0E", (), 0).packet()
        return scip.Reply(line, scip.OK, lines, 0).packet()


class OldRplidar:
    """An RPLIDAR with firmware without scan modes: A1, or A2 on its USB board. 2 000 nodes per second.

    stuck_after  seconds from the start of a scan after which its head stands still
    """

    def __init__(self, model: int, stuck_after: float = math.inf) -> None:
        self.model, self.stuck_after = model, stuck_after
        self.reader = requests.RequestReader()
        self.received: list[requests.Request] = []
        self.begun: float | None = None
        self.node = 0

    def __call__(self, received: bytes) -> bytes:
        sent = b"".join(self.answer(request) for request in self.reader.feed(received))
        if self.begun is not None:
            due = int((time.monotonic() - self.begun) * 2000) - self.node
            nodes = np.minimum(self.node + np.arange(-1, due), self.stuck_after * 2000)
            turns = nodes[1:] * 5.5 / 2000 + 1e-9
            starts = np.diff(np.floor(nodes * 5.5 / 2000 + 1e-9)) > 0
            sent += standard.encode(2 * np.pi * turns, np.full(due, 2.0), np.full(due, 20), starts)
            self.node += due
        return sent

    def answer(self, request: requests.Request) -> bytes:
        self.received.append(request)
        answers = {
            Command.GET_INFO: (ResponseType.INFO, Info(self.model, (1, 20), 5, "AB" * 16).payload()),
            Command.GET_HEALTH: (ResponseType.HEALTH, Health(HealthStatus.WARNING, 1).payload()),
            Command.GET_SAMPLE_RATE: (ResponseType.SAMPLE_RATE, SampleRate(500e-6, 250e-6).payload()),
            Command.GET_MOTOR_BOARD: (ResponseType.MOTOR_BOARD, bytes([1, 0, 0, 0])),
        }
        if request.command == Command.STOP:
            self.begun = None
        elif request.command == Command.SCAN:
            self.begun, self.node = time.monotonic(), 0
            return descriptor_of(ResponseType.STANDARD).packet()
        elif request.command in answers:
            kind, payload = answers[Command(request.command)]
            return Descriptor(len(payload), False, kind).packet() + payload
        return b""


class BasePeer:
    """A wheel base that drives straight on; its left and right counters grow by 10 in each period."""

    def __init__(self, device: Any, unit: float = 1.0, polled: bool = False, period: float = 0.02) -> None:
        self.device, self.unit, self.polled, self.period = device, unit, polled, period
        self.begun, self.reading = time.monotonic(), 0
        self.requests: list[Any] = []

    def __call__(self, received: bytes) -> bytes:
        sent = b""
        for request in self.device.feed(received):
            self.requests.append(request)
            if isinstance(request, Poll):
                sent += self.encode_reading(time.monotonic() - self.begun)
        elapsed = time.monotonic() - self.begun
        while not self.polled and self.reading * self.period < elapsed:
            sent += self.encode_reading(self.reading * self.period)
            self.reading += 1
        return sent

    def encode_reading(self, when: float) -> bytes:
        count = round(when / self.period * 10)
        return bytes(self.device.encode(WheelReading(count, count, round(when / self.unit), heading=0.0)))


DRIVE = DifferentialDrive(2 * math.pi * 0.05 / 1000, 2 * math.pi * 0.05 / 1000, 0.3, 32, 1.5)
KINDS: dict[str, tuple[Callable[[], Behaviour], str, str, type]] = {
    "ld06": (Ld06Peer, "", "LD06", Scan),
    "scip": (ScipPeer, "", "URG-04LX, serial number H42", Scan),
    "create2": (lambda: BasePeer(Create2Device(), period=0.015), "", "Create 2", Odometry),
    "kobuki": (lambda: BasePeer(KobukiDevice(), 0.001), "", "Kobuki", Odometry),
    "wheels": (lambda: BasePeer(WheelLineDevice(), 1e-6), WHEELS, "line protocol", Odometry),
    "arduino": (lambda: BasePeer(ArduinoBridgeDevice(DRIVE), polled=True), WHEELS, "ros_arduino_bridge", Odometry),
}


@contextmanager
def serving(write: Callable[[bytes], Any], read: Callable[[], bytes], behaviour: Behaviour) -> Iterator[None]:
    """Run a device in a thread."""
    over = threading.Event()

    def serve() -> None:
        while not over.is_set():
            received = b""
            with suppress(OSError):
                received = read()
            with suppress(OSError):
                write(behaviour(received))
            time.sleep(0.004)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def plugged(behaviour: Behaviour) -> Iterator[str]:
    """Yield the path of a terminal with a device behind it."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    try:
        with serving(lambda data: os.write(ours, data), lambda: os.read(ours, 4096), behaviour):
            yield os.ttyname(theirs)
    finally:
        os.close(theirs)
        os.close(ours)

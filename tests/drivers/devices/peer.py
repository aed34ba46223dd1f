"""Emulated devices as a program: an RPLIDAR S1 and a Create 2 behind pseudo terminals, in real time.

    python peer.py DIRECTORY [--sick] [--deaf] [--noise]

Links DIRECTORY/lidar and DIRECTORY/base to the terminals. Prints events on stdout, one JSON object per line; executes
commands from stdin: `unplug lidar 2.0` (seconds), `stall base 1.5`, `restart lidar`, `garbage lidar`.

The lidar's ranges encode the number of the revolution, the base's counts the number of the reading, so that a reader
knows when they were measured.
"""

from __future__ import annotations

import json
import math
import os
import pty
import random
import sys
import threading
import time
import tty
from pathlib import Path
from typing import Any

import numpy as np

from drivers.bases import Create2Device, Stream, WheelReading
from drivers.lidars.rplidar import dense
from drivers.lidars.rplidar.decoding import descriptor_of
from drivers.lidars.rplidar.modes import Modes, ScanMode, configuration_response
from drivers.lidars.rplidar.requests import Command, Request, RequestReader
from drivers.lidars.rplidar.responses import Descriptor, Health, HealthStatus, Info, ResponseType
from drivers.realtime import realtime_priority

RATE, TURNS, BAUD = 9200.0, 9.7, 256000
SAMPLES = 40
WIRE = 84 * 10 / BAUD
MODES = Modes((ScanMode(0, "Standard", 1 / RATE, 40.0, 0x81), ScanMode(1, "DenseBoost", 1 / RATE, 40.0, 0x85)), 1)
SERIAL = "00112233445566778899AABBCCDDEEFF"
BANNER = b"RP S1 LIDAR System.\r\nFirmware Ver 1.29 - rc2, HW Ver 7\r\nModel: 97\r\n"
BASE_PERIOD, BASE_WIRE, BASE_COUNTS = 0.015, 9 * 10 / 115200, 10

FROZEN = 0.3
"""Seconds that this program was not scheduled; the devices were not realistic then."""

lock = threading.Lock()


def report_event(**what: Any) -> None:
    with lock:
        print(json.dumps(what), flush=True)


class Terminal:
    """One end of a pseudo terminal, the other end linked to a path; it can be unplugged."""

    def __init__(self, link: Path) -> None:
        self.link, self.name = link, link.name
        self.noise = 1e-4 if "--noise" in sys.argv else 0.0
        self.faults, self.random = 0, random.Random(1)
        self.until = 0.0  # end of an unplugged or stalled state
        self.fd = -1
        self.plug()

    def plug(self) -> None:
        self.fd, theirs = pty.openpty()
        tty.setraw(theirs)
        os.set_blocking(self.fd, False)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(theirs))
        os.close(theirs)

    def unplug(self, seconds: float) -> None:
        self.link.unlink()
        os.close(self.fd)
        self.fd, self.until = -1, time.monotonic() + seconds

    def replug_if_due(self) -> None:
        if self.fd < 0 and time.monotonic() > self.until:
            self.plug()

    def write(self, data: bytes) -> None:
        data = self.add_noise(data)
        try:
            if self.fd >= 0 and time.monotonic() > self.until:
                os.write(self.fd, data)
        except OSError:
            pass  # no program has the terminal open, or does not read

    def add_noise(self, data: bytes) -> bytes:
        """Drop, insert or flip a small share of the bytes."""
        if not self.noise:
            return data
        out = bytearray()
        for byte in data:
            fault = self.random.choice("dif") if self.random.random() < self.noise else ""
            out += {"": bytes([byte]), "d": b"", "i": bytes([byte, 0xA5]), "f": bytes([byte ^ 0x40])}[fault]
            self.faults += bool(fault)
        return bytes(out)

    def read(self) -> bytes:
        try:
            return os.read(self.fd, 4096) if self.fd >= 0 else b""
        except OSError:
            return b""


class LidarPeer:
    def __init__(self, terminal: Terminal, reports_error: bool) -> None:
        self.terminal, self.reports_error = terminal, reports_error
        self.requests = RequestReader()
        self.begun: float | None = None
        self.capsule = 0

    def due(self) -> float | None:
        if self.begun is None:
            return None
        return self.begun + ((self.capsule + 1) * SAMPLES + 0.5) / RATE + WIRE

    def send(self) -> None:
        samples = self.capsule * SAMPLES + np.arange(SAMPLES)
        turns = samples * (TURNS / RATE) + 1e-9
        ranges = 1.0 + 0.002 * np.floor(turns)
        heads = np.array([2 * math.pi * turns[0]])
        self.terminal.write(dense.encode(heads, ranges[None], reset=self.capsule == 0))
        self.capsule += 1

    def receive(self, data: bytes) -> None:
        for request in self.requests.feed(data):
            self.execute(request)

    def answer(self, kind: ResponseType, payload: bytes) -> None:
        self.terminal.write(Descriptor(len(payload), False, kind).packet() + payload)

    def execute(self, request: Request) -> None:
        command = request.command
        if command == Command.STOP:
            report_event(event="stop", scanning=self.begun is not None)
            self.begun = None
        elif command == Command.RESET:
            report_event(event="reset")
            self.restart()
        elif command == Command.SET_MOTOR_SPEED:
            report_event(event="motor", speed=int.from_bytes(request.payload, "little"))
        elif self.begun is not None:
            return
        elif command == Command.GET_INFO:
            self.answer(ResponseType.INFO, Info(0x61, (1, 29), 7, SERIAL).payload())
        elif command == Command.GET_HEALTH:
            health = Health(HealthStatus.ERROR, 4) if self.reports_error else Health(HealthStatus.GOOD, 0)
            self.answer(ResponseType.HEALTH, health.payload())
        elif command == Command.GET_CONFIGURATION:
            payload = configuration_response(request, MODES)
            if payload is not None:
                self.answer(ResponseType.CONFIGURATION, payload)
        elif command == Command.EXPRESS_SCAN:
            self.terminal.write(descriptor_of(0x85).packet())
            self.begun, self.capsule = time.monotonic(), 0
            report_event(event="scan", begun=self.begun)

    def restart(self) -> None:
        self.begun, self.reports_error = None, False
        self.terminal.write(BANNER)


class BasePeer:
    def __init__(self, terminal: Terminal) -> None:
        self.terminal = terminal
        self.device = Create2Device()
        self.begun: float | None = time.monotonic()
        self.streams = False
        self.reading = 0
        report_event(event="base", begun=self.begun)

    def due(self) -> float | None:
        return self.begun + self.reading * BASE_PERIOD + BASE_WIRE if self.begun is not None else None

    def send(self) -> None:
        count = self.reading * BASE_COUNTS
        if self.streams:
            self.terminal.write(self.device.encode(WheelReading(count, count)))
        self.reading += 1

    def receive(self, data: bytes) -> None:
        for request in self.device.feed(data):
            if isinstance(request, Stream):
                self.streams = request.on
            report_event(event="base request", what=repr(request))

    def restart(self) -> None:
        self.reading = 0


def execute_stdin(peers: dict[str, Any]) -> None:
    for line in sys.stdin:
        verb, name, *rest = line.split()
        peer = peers[name]
        if verb == "unplug":
            peer.terminal.unplug(float(rest[0]))
        elif verb == "stall":
            peer.terminal.until = time.monotonic() + float(rest[0])
        elif verb == "restart":
            peer.restart()
        elif verb == "garbage":
            peer.terminal.write(bytes(range(200)))
    os._exit(0)  # the parent process has ended


def main() -> None:
    directory = Path(sys.argv[1])
    lidar = LidarPeer(Terminal(directory / "lidar"), "--sick" in sys.argv)
    base = BasePeer(Terminal(directory / "base"))
    peers = {"lidar": lidar, "base": base}
    threading.Thread(target=execute_stdin, args=(peers,), daemon=True).start()
    report_event(event="ready")
    before = time.monotonic()
    while True:
        if time.monotonic() - before > FROZEN:
            report_event(event="frozen", seconds=time.monotonic() - before)
        before = time.monotonic()
        for peer in peers.values():
            peer.terminal.replug_if_due()
            if (data := peer.terminal.read()) and "--deaf" not in sys.argv:
                peer.receive(data)
            while (due := peer.due()) is not None and due <= time.monotonic():
                peer.send()
        dues = [due for peer in peers.values() if (due := peer.due()) is not None]
        time.sleep(max(0.0, min([*(due - time.monotonic() for due in dues), 0.005])))


if __name__ == "__main__":
    with realtime_priority():  # hardware does not wait for a processor
        main()

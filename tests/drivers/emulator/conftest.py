"""An emulator with simulated time, with its ports opened like by any program.

The system passes bytes through a pseudo terminal when it has time: on a busy computer after many steps of the
emulator. The bench waits for them, so that in simulated time all bytes arrive in the step in which they were sent.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.emulator import Emulator, EmulatorSetup
from drivers.emulator.connection import DeviceConnection
from drivers.lidars.rplidar.requests import Request
from drivers.lidars.rplidar.responses import ResponseReader
from drivers.messages import Floats
from drivers.simulation import LidarModel, WheelModel
from drivers.transport import SerialPort

EXACT = LidarModel(sigma_range=0.0, sigma_bearing=0.0, dropouts=0.0, mixed=0.0)
PATIENCE = 60.0
"""Time that the system may take to pass bytes on, seconds."""
PERFECT = WheelModel(slip=0.0, encoder=0.0, scale_bias=0.0, difference_bias=0.0, wheelbase_bias=0.0)


class Host:
    """A program that has a port open; the bytes read and their times."""

    def __init__(self, bench: Bench, link: DeviceConnection, baud: int) -> None:
        self.bench, self.link = bench, link
        self.port = SerialPort(str(link.port.path), baud)
        self.data = b""
        self._chunks: list[tuple[int, float]] = []
        self._read = link.counts.sent

    def read(self) -> bytes:
        """Read all bytes that the device has sent."""
        data = self.port.read(0.0).data
        while self._read + len(data) < self.link.counts.sent:
            more = self.port.read(PATIENCE).data
            assert more, "bytes were lost in the pseudo terminal"
            data += more
        self._read += len(data)
        if data:
            self.data += data
            self._chunks.append((len(self.data), self.bench.time))
        return data

    def write(self, data: bytes) -> None:
        """Send bytes, which the device then has."""
        received, deadline = self.link.counts.received + len(data), time.monotonic() + PATIENCE
        self.port.write(data)
        while self.link.counts.received < received:
            assert time.monotonic() < deadline, "bytes were lost in the pseudo terminal"
            self.link.step(self.bench.time)

    def forget(self) -> None:
        self.data, self._chunks = b"", []

    def arrivals(self, ends: Any) -> Floats:
        """Return the arrival times of bytes up to `ends`, counted since the last `forget`."""
        counts, times = np.array(self._chunks).T
        return np.asarray(times[np.searchsorted(counts, ends)])

    def ask(self, request: Request, answer: ResponseReader, patience: float = 0.3) -> bytes | None:
        """Send a request to an RPLIDAR; return the payload of its response, None if there is none."""
        self.write(request.packet())
        until = self.bench.time + patience
        while self.bench.time < until:
            self.bench.tick()
            if (payload := answer.feed(self.read())) is not None:
                return payload
        return None


class Bench:
    """Test bench with simulated time; all open ports are read at every tick."""

    def __init__(self, emulator: Emulator, opened: ExitStack) -> None:
        self.emulator, self.time, self.step = emulator, 0.0, 0.004
        self.hosts: list[Host] = []
        self._opened = opened

    def open(self, who: str, baud: int = 115200) -> Host:
        host = Host(self, getattr(self.emulator, who), baud)
        self._opened.callback(host.port.close)
        self.hosts.append(host)
        return host

    def close(self, host: Host) -> None:
        host.port.close()
        self.hosts.remove(host)

    def tick(self) -> None:
        self.time += self.step
        self.emulator.step(self.time)

    def go(self, seconds: float) -> None:
        until = self.time + seconds - self.step / 2
        while self.time < until:
            self.tick()
            for host in self.hosts:
                host.read()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    """Create benches; the robot is in a room, with exact sensors unless stated otherwise."""
    with ExitStack() as opened:

        def make(**wanted: Any) -> Bench:
            folder = tmp_path / f"robot{len(list(tmp_path.iterdir()))}"
            ports = {"lidar_port": folder / "lidar", "base_port": folder / "base"}
            settings: dict[str, Any] = {"world": "room", "noise": EXACT, "wheels": PERFECT, **ports, **wanted}
            emulator = opened.enter_context(Emulator(EmulatorSetup(**settings), begun=1000.0))
            return Bench(emulator, opened)

        yield make

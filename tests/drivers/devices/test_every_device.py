"""Every kind of device behind a pseudo terminal or a socket: identified, started, read and halted by its supervisor."""

from __future__ import annotations

import math
import os
import pty
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import Message, Odometry, Scan
from drivers.bases import (
    ArduinoBridgeDevice,
    Create2Device,
    DifferentialDrive,
    KobukiDevice,
    Poll,
    Velocity,
    WheelLineDevice,
    WheelReading,
)
from drivers.devices import ports
from drivers.devices import supervisor as supervisor_module
from drivers.devices.device_spec import parse_device
from drivers.devices.probing import probe
from drivers.devices.supervisor import DeviceState, Supervisor
from drivers.errors import DriverError
from drivers.lidars import ld06, scip, scip_scan
from drivers.lidars.rplidar import requests, standard
from drivers.lidars.rplidar.decoding import descriptor_of
from drivers.lidars.rplidar.requests import Command
from drivers.lidars.rplidar.responses import Descriptor, Health, HealthStatus, Info, ResponseType, SampleRate
from drivers.transport.replay_port import ReplayPort

RUN = 1.2
WHEELS = "wheel_radius=0.05&ticks=1000&track=0.3"
URG = scip.Parameters("URG-04LX", 0.02, 5.6, 1024, 44, 725, 384, 600.0)

Behaviour = Callable[[bytes], bytes]
"""Returns the bytes that a device sends; called often with the received bytes."""


class Ld06Peer:
    def __init__(self) -> None:
        self.begun, self.packet = time.monotonic(), 0

    def __call__(self, received: bytes) -> bytes:
        sent = b""
        while (self.packet + 1) * 12 / 4500 < time.monotonic() - self.begun:
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
        while self.measure and self.scan * 0.1 < time.monotonic() - self.begun:
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
        elif line.startswith(b"MD") and self.laser:
            self.measure = scip.MeasureRequest(URG.first, URG.last)
            self.begun, self.scan = time.monotonic(), 0
        return scip.Reply(line, scip.OK, lines, 0).packet()


class OldRplidar:
    """An RPLIDAR with firmware without scan modes: A1, or A2 on its USB board. 2 000 nodes per second."""

    def __init__(self, model: int) -> None:
        self.model = model
        self.reader = requests.RequestReader()
        self.received: list[requests.Request] = []
        self.begun: float | None = None
        self.node = 0

    def __call__(self, received: bytes) -> bytes:
        sent = b"".join(self.answer(request) for request in self.reader.feed(received))
        if self.begun is not None:
            due = int((time.monotonic() - self.begun) * 2000) - self.node
            turns = (self.node + np.arange(due)) * 5.5 / 2000 + 1e-9
            starts = np.diff(np.floor(turns), prepend=np.floor(turns[0] - 5.5 / 2000)) > 0 if due else np.empty(0, bool)
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
        while not self.polled and self.reading * self.period < time.monotonic() - self.begun:
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


def run_supervisor(text: str, seconds: float = RUN) -> tuple[Supervisor, list[Message]]:
    messages: list[Message] = []
    supervisor = Supervisor(parse_device(text), messages.extend)
    stop = threading.Event()
    timer = threading.Timer(seconds, stop.set)
    timer.start()
    supervisor.run(stop)
    timer.cancel()
    return supervisor, messages


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_device_is_identified_and_read(kind: str) -> None:
    make, options, name, type_of_message = KINDS[kind]
    with plugged(make()) as path:
        before = time.monotonic()
        supervisor, messages = run_supervisor(f"{kind}:{path}?{options}", RUN + (1.5 if kind == "scip" else 0.0))
        after = time.monotonic()
    assert supervisor.failure is None
    status = supervisor.status()
    assert name in status.identity
    assert status.state is DeviceState.ENDED
    assert status.counters["connections"] == 1
    assert status.counters["losses"] == 0
    assert len(messages) >= (6 if type_of_message is Scan else 25)
    assert {type(message) for message in messages} == {type_of_message}
    stamps = np.array([message.stamp for message in messages])
    assert np.all(np.diff(stamps) > 0.0)
    assert before - 0.5 < stamps[0] < stamps[-1] < after
    period = 0.1 if type_of_message is Scan else {"create2": 0.015}.get(kind, 0.02)
    slowest = 2.0 if kind == "arduino" else 1.2  # a base that is polled is as slow as a busy host
    assert 0.8 * period <= np.median(np.diff(stamps)) <= slowest * period


def test_read_until_advances_after_messages_were_put() -> None:
    times: list[float] = []

    def put(messages: list[Message]) -> None:
        times.extend((supervisor.read_until, time.monotonic()))
        time.sleep(0.2)
        times.append(supervisor.read_until)

    with plugged(Ld06Peer()) as path:
        supervisor = Supervisor(parse_device(f"ld06:{path}"), put)
        stop = threading.Event()
        thread = threading.Thread(target=supervisor.run, args=(stop,))
        thread.start()
        wait_until(lambda: len(times) >= 9)
        stop.set()
        thread.join()
    for before, begun, while_putting in zip(times[::3], times[1::3], times[2::3], strict=True):
        assert before == while_putting < begun
    assert times[6] > times[1]
    assert supervisor.read_until == math.inf


@pytest.mark.parametrize(("model", "duties"), [(0x18, []), (0x28, [660, 0])], ids=["A1", "A2"])
def test_old_rplidars_scan_and_stop_their_motors(model: int, duties: list[int]) -> None:
    peer = OldRplidar(model)
    with plugged(peer) as path:
        supervisor, messages = run_supervisor(f"rplidar:{path}", 2.0)
        time.sleep(0.05)
    assert supervisor.failure is None
    assert "M8, firmware 1.20" in supervisor.status().identity
    assert supervisor.status().identity.endswith("mode Standard")
    assert len(messages) >= 4
    stamps = np.array([message.stamp for message in messages])
    np.testing.assert_allclose(np.diff(stamps), 1 / 5.5, atol=0.01)
    sent_duties = [int.from_bytes(r.payload, "little") for r in peer.received if r.command == Command.SET_MOTOR_PWM]
    assert sent_duties == duties
    assert peer.begun is None


@pytest.mark.parametrize("kind", ["kobuki", "wheels", "arduino"])
def test_wheel_bases_are_stopped_at_the_end(kind: str) -> None:
    make, options, _, _ = KINDS[kind]
    peer = make()
    assert isinstance(peer, BasePeer)
    with plugged(peer) as path:
        run_supervisor(f"{kind}:{path}?{options}", 0.5)
        time.sleep(0.05)
    assert [request for request in peer.requests if not isinstance(request, Poll)][-1] == Velocity(0.0, 0.0)


def test_odometry_has_the_speed_of_the_wheels() -> None:
    with plugged(KINDS["wheels"][0]()) as path:
        _, messages = run_supervisor(f"wheels:{path}?{WHEELS}")
    odometry = [message for message in messages if isinstance(message, Odometry)]
    distances = np.diff([message.pose[0] for message in odometry])
    # The median, because a busy computer runs the emulated base late, and the first stamps follow its delays.
    speed = np.median(distances / np.diff([message.stamp for message in odometry]))
    assert speed == pytest.approx(10 * DRIVE.left / 0.02, rel=0.01)


def test_options_of_a_lidar_are_applied_to_its_scans() -> None:
    with plugged(Ld06Peer()) as path:
        _, messages = run_supervisor(f"ld06:{path}?mount=0.1,0.2,0.3&range_max=1.0", 0.8)
    scan = messages[0]
    assert isinstance(scan, Scan)
    np.testing.assert_array_equal(scan.mount, [0.1, 0.2, 0.3])
    assert scan.range_max == 1.0
    assert np.isnan(scan.ranges).all()


def test_a_lidar_is_read_over_tcp() -> None:
    with ExitStack() as stack:
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        accepted: list[socket.socket] = []
        peer = Ld06Peer()

        def accept() -> None:
            accepted.append(server.accept()[0])
            accepted[0].setblocking(False)

        thread = threading.Thread(target=accept)
        thread.start()
        write = lambda data: accepted and accepted[0].sendall(data)  # noqa: E731
        read = lambda: accepted[0].recv(4096) if accepted else b""  # noqa: E731
        stack.enter_context(serving(write, read, peer))
        supervisor, messages = run_supervisor(f"ld06:127.0.0.1:{server.getsockname()[1]}")
        thread.join()
        accepted[0].close()
    assert supervisor.failure is None
    assert len(messages) > 5


def test_a_device_with_a_serial_number_is_found_on_another_port(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(supervisor_module, "SILENCE_TIMEOUT", 0.3)
    link = tmp_path / "lidar"
    messages: list[Message] = []
    stop = threading.Event()
    with ExitStack() as stack:
        one = Supervisor(parse_device(f"scip:{link}?baud=115200"), messages.extend)
        monkeypatch.setattr(ports, "serial_ports", lambda: [ports.Port(str(elsewhere), "")])
        first = ExitStack()
        link.symlink_to(first.enter_context(plugged(ScipPeer())))
        elsewhere = tmp_path / "elsewhere"
        thread = threading.Thread(target=one.run, args=(stop,))
        thread.start()
        wait_until(lambda: len(messages) > 2)
        link.unlink()
        first.close()
        elsewhere.symlink_to(stack.enter_context(plugged(ScipPeer())))
        count = len(messages)
        wait_until(lambda: len(messages) > count + 3)
        assert one.status().port == str(elsewhere)
        stop.set()
        thread.join()
    assert one.status().counters["losses"] == 1


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 15.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.slow
def test_auto_finds_the_port(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with plugged(lambda _: b"") as empty, plugged(Ld06Peer()) as path:
        monkeypatch.setattr(ports, "serial_ports", lambda: [ports.Port(empty, ""), ports.Port(path, "")])
        supervisor, messages = run_supervisor("ld06:auto", 3.0)
    assert supervisor.status().port == path
    assert len(messages) > 3


def test_a_search_without_ports_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "serial_ports", lambda: [])
    supervisor, _ = run_supervisor("ld06:auto")
    assert isinstance(supervisor.failure, DriverError)
    assert "no serial port found" in str(supervisor.failure)


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[] if kind == "ld06" else pytest.mark.slow) for kind in KINDS]
)
def test_probing_identifies_the_device(kind: str) -> None:
    make, _, name, _ = KINDS[kind]
    peer = make()
    with plugged(peer) as path:
        found = probe(path)
    assert name in found
    assert found.endswith(f"->  {kind}:{path}")


def test_a_byte_capture_replays_the_device(tmp_path: Path) -> None:
    """The byte capture of a device with requests, replayed behind a terminal."""
    tape = tmp_path / "scip.tape"
    with plugged(ScipPeer()) as path:
        _, live = run_supervisor(f"scip:{path}?tape={tape}&baud=115200", 2.0)
    with ReplayPort(tape) as port:
        player = threading.Thread(target=port.play)
        player.start()
        _, again = run_supervisor(f"scip:{port.name}?baud=115200", 2.5)
        player.join()
    assert len(live) > 3
    assert abs(len(again) - len(live)) <= 1
    for before, after in zip(live, again, strict=False):
        assert isinstance(before, Scan)
        assert isinstance(after, Scan)
        np.testing.assert_array_equal(before.ranges, after.ranges)
        np.testing.assert_array_equal(before.angles, after.angles)


def test_the_supervisor_ends_with_the_byte_capture(tmp_path: Path) -> None:
    tape = tmp_path / "ld06.tape"
    with plugged(Ld06Peer()) as path:
        run_supervisor(f"ld06:{path}?tape={tape}", 0.9)
    supervisor, messages = run_supervisor(f"ld06:tape:{tape}", 20.0)
    assert supervisor.failure is None
    assert supervisor.state is DeviceState.ENDED
    assert len(messages) >= 2


def test_a_byte_capture_continues_over_a_new_connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "SILENCE_TIMEOUT", 0.1)
    tape, peer = tmp_path / "ld06.tape", Ld06Peer()
    pauses = 0.6

    def pausing(received: bytes) -> bytes:
        sent = peer(received)
        return sent if not 0.5 < time.monotonic() - peer.begun < 0.5 + pauses else b""

    with plugged(pausing) as path:
        one, _ = run_supervisor(f"ld06:{path}?tape={tape}", 2.5)
    assert one.status().counters["silences"] >= 1
    assert tape.read_text().count("# /dev/") >= 2


def test_an_unwritable_byte_capture_is_an_error(tmp_path: Path) -> None:
    with plugged(Ld06Peer()) as path:
        supervisor, _ = run_supervisor(f"ld06:{path}?tape={tmp_path}/no/such")
    assert "cannot be written" in str(supervisor.failure)

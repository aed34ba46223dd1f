"""Every kind of device behind a pseudo terminal or a socket: identified, started, read and halted by its supervisor."""

from __future__ import annotations

import math
import re
import socket
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from drivers import Message, Odometry, Scan
from drivers.bases import Velocity
from drivers.bases.arduino_bridge import ArduinoBridgeDevice
from drivers.bases.interface import Poll
from drivers.devices import ports
from drivers.devices import supervisor as supervisor_module
from drivers.devices.device_spec import parse_device
from drivers.devices.probing import probe
from drivers.devices.rplidar import RplidarDevice
from drivers.devices.supervisor import DeviceState, Supervisor
from drivers.devices.wheel_base import POLL_TIMEOUT, WAKE_PULSE
from drivers.errors import DriverError
from drivers.lidars.rplidar.requests import Command
from drivers.transport import SerialPort
from drivers.transport.replay_port import ReplayPort

from .device_peers import DRIVE, KINDS, WHEELS, BasePeer, Ld06Peer, OldRplidar, ScipPeer, plugged, serving

Condition = Callable[[Supervisor, list[Message]], bool]


def run_supervisor(
    text: str, count: int = 1, until: Condition | None = None, timeout: float = 30.0
) -> tuple[Supervisor, list[Message]]:
    """Read a device until it ends, `count` messages have arrived or a condition is met; `timeout` in seconds.

    The duration is not fixed, because a busy computer runs the emulated devices late.
    """
    messages: list[Message] = []
    supervisor = Supervisor(parse_device(text), messages.extend)
    stop, ended = threading.Event(), threading.Event()

    def watch() -> None:
        end = time.monotonic() + timeout
        while not ended.wait(0.01) and time.monotonic() < end:
            if until(supervisor, messages) if until else len(messages) >= count:
                break
        stop.set()

    watcher = threading.Thread(target=watch)
    watcher.start()
    supervisor.run(stop)
    ended.set()
    watcher.join()
    return supervisor, messages


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_device_is_identified_and_read(kind: str) -> None:
    make, options, name, type_of_message = KINDS[kind]
    count = 5 if type_of_message is Scan else 25
    with plugged(make()) as path:
        before = time.monotonic()
        supervisor, messages = run_supervisor(f"{kind}:{path}?{options}", count)
        after = time.monotonic()
    assert supervisor.failure is None
    status = supervisor.status()
    assert name in status.identity
    assert status.state is DeviceState.ENDED
    assert status.counters["connections"] == 1
    assert status.counters["losses"] == 0
    assert len(messages) >= count
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


@pytest.mark.parametrize(
    ("model", "duties"), [(0x18, []), pytest.param(0x28, [660, 0], marks=pytest.mark.slow)], ids=["A1", "A2"]
)
def test_old_rplidars_scan_and_stop_their_motors(model: int, duties: list[int]) -> None:
    peer = OldRplidar(model)
    with plugged(peer) as path:
        supervisor, messages = run_supervisor(f"rplidar:{path}", 5)
        wait_until(lambda: peer.begun is None and len(sent_duties(peer)) == len(duties))
    assert supervisor.failure is None
    assert "M8, firmware 1.20" in supervisor.status().identity
    assert supervisor.status().identity.endswith("mode Standard")
    assert len(messages) >= 5
    # The median, because a busy computer runs the emulated lidar late, which looks like lost nodes.
    assert np.median(np.diff([message.stamp for message in messages])) == pytest.approx(1 / 5.5, abs=0.01)
    assert sent_duties(peer) == duties


@pytest.mark.parametrize("stuck_after", [0.01, 1.0])
def test_a_lidar_whose_head_is_stuck_is_named_and_started_again(
    monkeypatch: pytest.MonkeyPatch, stuck_after: float
) -> None:
    """It goes on to send measurements, all in one direction."""
    monkeypatch.setattr(RplidarDevice, "start_timeout", 1.0)
    peer = OldRplidar(0x18, stuck_after)
    with plugged(peer) as path:
        supervisor, _ = run_supervisor(
            f"rplidar:{path}", until=lambda one, _: one.status().counters["connections"] == 2
        )
    assert supervisor.status().counters["useless"] == 1
    assert supervisor.status().problem.endswith("mode Standard measures, but no whole turn; does its head turn?")
    assert [request.command for request in peer.received].count(Command.SCAN) == 2


def sent_duties(peer: OldRplidar) -> list[int]:
    return [int.from_bytes(r.payload, "little") for r in peer.received if r.command == Command.SET_MOTOR_PWM]


@pytest.mark.parametrize("kind", ["create2", "kobuki", "wheels", "arduino"])
def test_wheel_bases_that_are_only_read_receive_no_velocity(kind: str) -> None:
    make, options, _, _ = KINDS[kind]
    peer = make()
    assert isinstance(peer, BasePeer)
    with plugged(peer) as path:
        run_supervisor(f"{kind}:{path}?{options}", 5)
        time.sleep(0.1)
    assert not any(isinstance(request, Velocity) for request in peer.requests)


def test_a_sleeping_create_is_woken_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pulse on RTS wakes it, before the start request is repeated."""
    asleep, peer, pulses = threading.Event(), KINDS["create2"][0](), []
    asleep.set()

    def pulse(port: SerialPort, duration: float) -> bool:
        pulses.append(duration)
        asleep.clear()
        return True

    monkeypatch.setattr(SerialPort, "pulse_rts", pulse)
    with plugged(lambda received: b"" if asleep.is_set() else peer(received)) as path:
        supervisor, messages = run_supervisor(f"create2:{path}", 20)
    assert supervisor.failure is None
    assert len(messages) >= 20
    assert pulses == [WAKE_PULSE]


def test_odometry_has_the_speed_of_the_wheels() -> None:
    with plugged(KINDS["wheels"][0]()) as path:
        _, messages = run_supervisor(f"wheels:{path}?{WHEELS}", 25)
    odometry = [message for message in messages if isinstance(message, Odometry)]
    distances = np.diff([message.pose[0] for message in odometry])
    # The median, because a busy computer runs the emulated base late, and the first stamps follow its delays.
    speed = np.median(distances / np.diff([message.stamp for message in odometry]))
    assert speed == pytest.approx(10 * DRIVE.left / 0.02, rel=0.01)


def test_options_of_a_lidar_are_applied_to_its_scans() -> None:
    with plugged(Ld06Peer()) as path:
        _, messages = run_supervisor(f"ld06:{path}?mount=0.1,0.2,0.3&range_max=1.0")
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
        supervisor, messages = run_supervisor(f"ld06:127.0.0.1:{server.getsockname()[1]}", 6)
        thread.join()
        accepted[0].close()
    assert supervisor.failure is None
    assert len(messages) > 5


@pytest.mark.parametrize("address", ["given", pytest.param("auto", marks=pytest.mark.slow)])
def test_a_lost_device_is_searched_only_where_the_user_allowed_it(
    address: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It comes back at another number, under the permanent name of its adapter; another port stays closed."""
    port, other = tmp_path / "ttyUSB0", tmp_path / "ttyUSB1"
    permanent = tmp_path / "by-id" / "usb-Hokuyo"
    permanent.parent.mkdir()
    permanent.symlink_to(port)
    opened: list[str] = []
    monkeypatch.setattr(ports, "PERMANENT_NAMES", permanent.parent)
    monkeypatch.setattr(ports, "SerialPort", lambda path, *rest: opened.append(path) or SerialPort(path, *rest))
    monkeypatch.setattr(ports, "serial_ports", lambda: [ports.Port(str(path), "") for path in (foreign, port, other)])
    messages: list[Message] = []
    stop = threading.Event()
    with ExitStack() as stack:
        foreign = stack.enter_context(plugged(lambda _: b""))
        one = Supervisor(parse_device(f"scip:{port if address == 'given' else 'auto'}?baud=115200"), messages.extend)
        first = ExitStack()
        port.symlink_to(first.enter_context(plugged(ScipPeer())))
        thread = threading.Thread(target=one.run, args=(stop,))
        thread.start()
        wait_until(lambda: len(messages) > 2)
        port.unlink()
        first.close()
        other.symlink_to(stack.enter_context(plugged(ScipPeer())))
        permanent.unlink()
        permanent.symlink_to(other)
        count = len(messages)
        wait_until(lambda: len(messages) > count + 3)
        assert one.status().port == str(permanent if address == "given" else other)
        stop.set()
        thread.join()
    assert one.status().counters["losses"] == 1
    assert (foreign in opened) == (address == "auto")


def test_devices_whose_ports_have_exchanged_their_numbers_are_found_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As after a fault of the hub: each is at the address that the user gave for the other one."""
    ttys, permanent = [tmp_path / "ttyUSB0", tmp_path / "ttyUSB1"], tmp_path / "by-id"
    permanent.mkdir()
    monkeypatch.setattr(ports, "PERMANENT_NAMES", permanent)
    received: tuple[list[Message], list[Message]] = ([], [])
    kinds, stop = (("ld06", Ld06Peer), ("scip", ScipPeer)), threading.Event()

    def plug_in(order: list[Path], stack: ExitStack) -> None:
        for (kind, peer), tty in zip(kinds, order, strict=True):
            tty.symlink_to(stack.enter_context(plugged(peer())))
            (permanent / kind).symlink_to(tty)

    specs = [f"{kind}:{tty}" for (kind, _), tty in zip(kinds, ttys, strict=True)]
    supervisors = [
        Supervisor(parse_device(spec), messages.extend, [str(tty) for tty in ttys if not spec.endswith(str(tty))])
        for spec, messages in zip(specs, received, strict=True)
    ]
    threads = [threading.Thread(target=supervisor.run, args=(stop,)) for supervisor in supervisors]
    with ExitStack() as second:
        with ExitStack() as first:
            plug_in(ttys, first)
            for thread in threads:
                thread.start()
            wait_until(lambda: all(len(messages) > 2 for messages in received))
            for path in (*ttys, *permanent.iterdir()):
                path.unlink()
        plug_in(ttys[::-1], second)
        before = [len(messages) for messages in received]
        wait_until(lambda: all(len(now) > count + 3 for now, count in zip(received, before, strict=True)))
        stop.set()
        for thread in threads:
            thread.join()
    assert [supervisor.status().port for supervisor in supervisors] == [str(permanent / kind) for kind, _ in kinds]


@pytest.mark.slow
def test_auto_finds_the_port(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with plugged(lambda _: b"") as empty, plugged(Ld06Peer()) as path:
        monkeypatch.setattr(ports, "serial_ports", lambda: [ports.Port(empty, ""), ports.Port(path, "")])
        supervisor, messages = run_supervisor("ld06:auto", 4)
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


def test_a_hokuyo_lidar_reports_intensities_on_request() -> None:
    with plugged(ScipPeer()) as path:
        _, messages = run_supervisor(f"scip:{path}?mode=intensity", 3)
    assert all(isinstance(scan, Scan) and scan.intensities is not None for scan in messages)


@pytest.mark.parametrize(
    ("mode", "problem"),
    [("last", "has no scan mode 'last'"), ("nearest", "'nearest'; there are: distance, intensity, last, strongest")],
)
def test_a_scan_mode_that_a_hokuyo_lidar_does_not_have_is_named(mode: str, problem: str) -> None:
    with plugged(ScipPeer()) as path:
        supervisor, messages = run_supervisor(f"scip:{path}?mode={mode}", until=lambda one, _: one.failure is not None)
    assert not messages
    assert problem in str(supervisor.failure)


def test_a_byte_capture_replays_the_device(tmp_path: Path) -> None:
    """The byte capture of a device with requests, replayed behind a terminal."""
    capture = tmp_path / "scip.tape"
    with plugged(ScipPeer()) as path:
        _, live = run_supervisor(f"scip:{path}?tape={capture}&baud=115200", 5)
    with ReplayPort(capture) as port:
        player = threading.Thread(target=port.play)
        player.start()
        _, again = run_supervisor(f"scip:{port.name}?baud=115200", until=lambda *_: not player.is_alive())
        player.join()
    assert len(live) > 3
    assert abs(len(again) - len(live)) <= 1
    for before, after in zip(live, again, strict=False):
        assert isinstance(before, Scan)
        assert isinstance(after, Scan)
        np.testing.assert_array_equal(before.ranges, after.ranges)
        np.testing.assert_array_equal(before.angles, after.angles)


def test_the_supervisor_ends_with_the_byte_capture(tmp_path: Path) -> None:
    capture = tmp_path / "ld06.tape"
    with plugged(Ld06Peer()) as path:
        run_supervisor(f"ld06:{path}?tape={capture}", 3)
    supervisor, messages = run_supervisor(f"ld06:tape:{capture}", until=lambda *_: False)
    assert supervisor.failure is None
    assert supervisor.state is DeviceState.ENDED
    assert len(messages) >= 2  # the last scan may be incomplete


def test_a_byte_capture_in_which_the_device_was_silent_is_played_on(tmp_path: Path) -> None:
    """It is what is attached to a report about a device that was lost."""
    capture = tmp_path / "ld06.tape"
    with plugged(Ld06Peer()) as path:
        run_supervisor(f"ld06:{path}?tape={capture}", 10)
    lines = capture.read_text().splitlines()
    late = [f"{float(line.split()[0]) + 1.5:.9f} {line.split(maxsplit=1)[1]}" for line in lines[len(lines) // 2 :]]
    capture.write_text("\n".join([*lines[: len(lines) // 2], *late, ""]))
    supervisor, messages = run_supervisor(f"ld06:tape:{capture}", until=lambda *_: False)
    assert supervisor.state is DeviceState.ENDED
    assert supervisor.status().counters["connections"] == 1
    assert 5 <= len(messages) <= 12


def test_a_byte_capture_of_another_computer_is_played(tmp_path: Path) -> None:
    """Its steady clock has been running for longer."""
    capture, other = tmp_path / "ld06.tape", tmp_path / "other.tape"
    with plugged(Ld06Peer()) as path:
        run_supervisor(f"ld06:{path}?tape={capture}", 3)
    other.write_text(re.sub(r"(?m)^(\d+)\.", r"9\1.", capture.read_text()))
    supervisor, messages = run_supervisor(f"ld06:tape:{other}", until=lambda *_: False)
    assert supervisor.failure is None
    assert len(messages) >= 2


@pytest.mark.parametrize("damage", ["missing", "wrong line"])
def test_a_byte_capture_that_cannot_be_played_is_one_line(tmp_path: Path, damage: str) -> None:
    capture = tmp_path / "ld06.tape"
    if damage == "wrong line":
        with plugged(Ld06Peer()) as path:
            run_supervisor(f"ld06:{path}?tape={capture}", 5)
        lines = capture.read_text().splitlines()
        capture.write_text("\n".join([*lines[: len(lines) // 2], "8137.2 = a5", *lines[len(lines) // 2 :]]))
    supervisor, _ = run_supervisor(f"ld06:tape:{capture}", until=lambda *_: False)
    assert supervisor.state is DeviceState.ENDED
    assert str(supervisor.failure).startswith(str(capture))


class LateBridge(BasePeer):
    """An arduino bridge that answers its 30th poll late, or not at all, and each poll with the counts at that time."""

    def __init__(self, delay: float) -> None:
        super().__init__(ArduinoBridgeDevice(DRIVE), polled=True)
        self.delay, self.polls, self.waiting = delay, 0, list[tuple[float, bytes]]()
        self.free_at = 0.0  # time from which it answers the next poll

    def __call__(self, received: bytes) -> bytes:
        now = time.monotonic()
        for request in self.device.feed(received):
            if isinstance(request, Poll):
                self.polls += 1
                due = now + self.delay if self.polls == 30 else max(now, self.free_at)
                self.free_at = due + 0.01 if math.isfinite(due) else now
                self.waiting.append((due, self.encode_reading(now - self.begun)))
        sent = b"".join(data for due, data in self.waiting if due <= now)
        self.waiting = [(due, data) for due, data in self.waiting if due > now]
        return sent


@pytest.mark.parametrize("delay", [1.5 * POLL_TIMEOUT, math.inf])
def test_a_late_response_of_a_polled_base_is_not_taken_for_the_next_one(delay: float) -> None:
    """Else all later readings would have the stamp of the poll after theirs."""
    peer = LateBridge(delay)
    with plugged(peer) as path:
        _, messages = run_supervisor(f"arduino:{path}?{WHEELS}", 70)
    odometry = [message for message in messages if isinstance(message, Odometry)]
    speed = 10 * DRIVE.left / peer.period
    lags = np.array([message.stamp - message.pose[0] / speed for message in odometry])
    assert abs(np.median(lags[-20:]) - np.median(lags[:20])) < 0.5 * peer.period


def test_a_byte_capture_continues_over_a_new_connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "SILENCE_TIMEOUT", 0.1)
    capture, peer = tmp_path / "ld06.tape", Ld06Peer()
    pauses = 0.6

    def pausing(received: bytes) -> bytes:
        sent = peer(received)
        return sent if not 0.5 < time.monotonic() - peer.begun < 0.5 + pauses else b""

    with plugged(pausing) as path:
        one, _ = run_supervisor(
            f"ld06:{path}?tape={capture}", until=lambda one, _: one.status().counters["connections"] >= 2
        )
    assert one.status().counters["silences"] >= 1
    assert capture.read_text().count("# /dev/") >= 2


def test_an_unwritable_byte_capture_is_an_error(tmp_path: Path) -> None:
    with plugged(Ld06Peer()) as path:
        supervisor, _ = run_supervisor(f"ld06:{path}?tape={tmp_path}/no/such")
    assert "cannot be written" in str(supervisor.failure)

"""Driving of wheel bases: commands reach the base within the limits, and the base stops if anything ends."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.bases import Create2, Create2Device, Velocity
from drivers.devices.acquisition import Acquisition
from drivers.devices.device_spec import parse_device, parse_devices
from drivers.devices.driving import COMMAND_TIMEOUT, BaseDriver, DriveCommand, DriveLimits
from drivers.devices.supervisor import Supervisor
from drivers.errors import DriverError

from .device_peers import KINDS, BasePeer, plugged

STOPPED = Velocity(0.0, 0.0)
BASES = [kind for kind, (make, *_) in KINDS.items() if isinstance(make(), BasePeer)]
COMMAND = Velocity(0.1, 0.4)


class Drive:
    """A supervisor that drives a base in a thread, with a command at each call of `command`."""

    def __init__(self, kind: str, path: str, peer: BasePeer) -> None:
        self.driver, self.peer = BaseDriver(DriveLimits(0.2, 0.8)), peer
        spec = parse_device(f"{kind}:{path}?{KINDS[kind][1]}")
        self._stop, self._messages = threading.Event(), 0
        self._supervisor = Supervisor(spec, self._count, driver=self.driver)
        self._thread = threading.Thread(target=self._supervisor.run, args=(self._stop,))
        self._thread.start()
        self.wait(lambda: self._messages > 0)

    def _count(self, messages: list[Any]) -> None:
        self._messages += len(messages)

    def command(self) -> None:
        self.driver.put(DriveCommand(COMMAND, time.monotonic()))

    @property
    def velocities(self) -> list[Velocity]:
        """All velocities that the base received."""
        return [request for request in self.peer.requests if isinstance(request, Velocity)]

    @property
    def drives(self) -> bool:
        return bool(self.velocities) and self.velocities[-1] != STOPPED

    def wait(self, condition: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
        end = time.monotonic() + 30.0
        while not condition():
            assert time.monotonic() < end
            each()
            time.sleep(0.02)

    def end(self) -> None:
        self._stop.set()
        self._thread.join()


def make_peer(kind: str) -> BasePeer:
    peer = KINDS[kind][0]()
    assert isinstance(peer, BasePeer)
    return peer


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[] if kind in ("arduino", "wheels") else pytest.mark.slow) for kind in BASES]
)
def test_a_base_drives_while_commands_come_and_stops_without_them(kind: str) -> None:
    peer = make_peer(kind)
    with plugged(peer) as path:
        drive = Drive(kind, path, peer)
        assert drive.velocities == []  # nothing is sent before the first command
        drive.wait(lambda: len(drive.velocities) > 2, drive.command)
        velocity = drive.velocities[-1]
        begun = time.monotonic()
        drive.wait(lambda: not drive.drives)
        stopped = time.monotonic() - begun
        drive.wait(lambda: drive.drives, drive.command)
        drive.end()
        drive.wait(lambda: not drive.drives)
    assert velocity.speed == pytest.approx(COMMAND.speed, abs=0.005)
    assert velocity.turn_rate == pytest.approx(COMMAND.turn_rate, abs=0.04)
    assert stopped > 0.5 * COMMAND_TIMEOUT  # it drove on until the command was invalid


def test_a_base_that_does_not_answer_is_stopped() -> None:
    peer = make_peer("kobuki")
    muted = threading.Event()

    def behave(received: bytes) -> bytes:
        sent = peer(received)
        return b"" if muted.is_set() else sent

    with plugged(behave) as path:
        drive = Drive("kobuki", path, peer)
        drive.wait(lambda: drive.drives, drive.command)
        muted.set()
        drive.wait(lambda: not drive.drives, drive.command)
        drive.end()


def test_an_expired_command_is_never_driven() -> None:
    driver, protocol = BaseDriver(DriveLimits()), Create2()
    driver.put(DriveCommand(COMMAND, 10.0))
    device = Create2Device()
    device.feed(protocol.start())
    assert device.feed(driver.output(protocol, 10.0 + COMMAND_TIMEOUT, 10.0 + COMMAND_TIMEOUT)) == []
    driver.put(DriveCommand(COMMAND, 11.0))
    (driven,) = device.feed(driver.output(protocol, 11.1, 11.1))
    assert driven == Velocity(pytest.approx(0.1, abs=0.001), pytest.approx(0.4, abs=0.01))
    assert driver.output(protocol, 11.15, 11.15) == b""
    driver.put(DriveCommand(STOPPED, 11.16))  # is sent at once
    assert device.feed(driver.output(protocol, 11.16, 11.16)) == [STOPPED]


def test_a_new_connection_stops_the_base_that_was_driven() -> None:
    protocol, device, driver = Create2(), Create2Device(), BaseDriver(DriveLimits())
    assert driver.restart(protocol) == b""
    driver.put(DriveCommand(COMMAND, 10.0))
    driver.output(protocol, 10.0, 10.0)
    assert device.feed(protocol.start() + driver.restart(protocol))[-1] == STOPPED


@given(speed=st.floats(-1e6, 1e6), turn_rate=st.floats(-1e6, 1e6))
def test_limits_keep_the_arc(speed: float, turn_rate: float) -> None:
    limits = DriveLimits(0.3, 0.7)
    limited = limits.apply(Velocity(speed, turn_rate))
    assert abs(limited.speed) <= 0.3 * (1 + 1e-12)
    assert abs(limited.turn_rate) <= 0.7 * (1 + 1e-12)
    assert limited.speed * turn_rate == pytest.approx(limited.turn_rate * speed)
    if abs(speed) <= 0.3 and abs(turn_rate) <= 0.7:
        assert limited == Velocity(speed, turn_rate)


@pytest.mark.parametrize(("speed", "turn_rate"), [(0.0, 1.0), (0.1, math.nan), (-0.1, 1.0), (math.inf, 1.0)])
def test_invalid_limits_are_refused(speed: float, turn_rate: float) -> None:
    with pytest.raises(DriverError, match="above 0"):
        DriveLimits(speed, turn_rate)


def test_driving_must_be_requested_and_requires_one_base() -> None:
    with (
        pytest.raises(DriverError, match="exactly one wheel base; 0"),
        Acquisition(parse_devices("ld06:/dev/nothing"), driving=DriveLimits()),
    ):
        pass
    with pytest.raises(DriverError, match="is not driven"):
        Acquisition(parse_devices("create2:/dev/nothing")).drive(0.1, 0.0)
    with pytest.raises(DriverError, match="finite"):
        Acquisition(parse_devices("create2:/dev/nothing"), driving=DriveLimits()).drive(math.nan, 0.0)


@pytest.mark.parametrize("fault", [signal.SIGKILL, pytest.param(signal.SIGTSTP, marks=pytest.mark.slow), "exit"])
def test_the_base_stops_if_a_process_ends(fault: signal.Signals | str) -> None:
    """Killing the reading process, Ctrl-Z while it is driven, and the end of the acquisition."""
    peer = make_peer("create2")

    def drives() -> bool:
        return [request for request in peer.requests if isinstance(request, Velocity)][-1:] == [Velocity(0.1, 0.0)]

    with plugged(peer) as path:
        with Acquisition(parse_devices(f"create2:{path}"), driving=DriveLimits()) as acquisition:
            end = time.monotonic() + 30.0
            while not drives() and time.monotonic() < end:
                acquisition.drive(0.1, 0.0)
                acquisition.receive(0.02)
            assert drives()
            if isinstance(fault, signal.Signals):
                (reader,) = multiprocessing.active_children()
                os.kill(reader.pid or 0, fault)
            if fault == signal.SIGKILL:
                with pytest.raises(DriverError, match="ended unexpectedly"):
                    list(acquisition)
            while fault != "exit" and drives():
                assert time.monotonic() < end
                time.sleep(0.02)
        end = time.monotonic() + 30.0
        while drives():
            assert time.monotonic() < end
            time.sleep(0.02)

"""Emulated wheel bases, read through pyserial on pseudo terminals by the drivers' own protocols."""

from __future__ import annotations

import os
import pty
import termios
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from drivers.bases import ArduinoBridge, Create2, Kobuki, Odometer, Velocity, WheelBase, WheelLine
from drivers.emulator.keyboard import apply_keys
from drivers.emulator.robot_motion import ROBOT_RADIUS, clearance
from drivers.emulator.wheel_base import ARDUINO_BOOT_DURATION, ARDUINO_GEOMETRY, BASE_VARIANTS
from drivers.messages import Floats
from drivers.se2 import between
from drivers.simulation import WheelModel

from .conftest import Bench, Host

MakeBench = Callable[..., Bench]

PROTOCOLS: dict[str, Callable[[], WheelBase]] = {
    "create2": Create2,
    "kobuki": Kobuki,
    "arduino": lambda: ArduinoBridge(ARDUINO_GEOMETRY),
    "wheels": lambda: WheelLine(ARDUINO_GEOMETRY),
}


def started(bench: Bench, name: str) -> tuple[Host, WheelBase]:
    """Return a wheel base that has been started."""
    protocol = PROTOCOLS[name]()
    host = bench.open("base", protocol.baud)
    bench.go(ARDUINO_BOOT_DURATION + 0.1)
    host.forget()
    host.write(protocol.start() + protocol.enable_driving())
    return host, protocol


def dead_reckon(bench: Bench, host: Host, protocol: WheelBase, seconds: float) -> tuple[Floats, Floats, Odometer]:
    """Return stamps (n,) and poses (n, 3) in the odometry's frame, and the odometer."""
    odometer = Odometer(protocol.wheels)
    stamps, poses = [], []
    until = bench.time + seconds
    while bench.time < until:
        if protocol.poll_period is not None:
            host.write(protocol.poll())
        bench.go(0.01)
        for reading in protocol.feed(host.data):
            message = odometer.add(reading, bench.time)
            if message is not None:
                stamps.append(bench.time)
                poses.append(message.pose)
        host.forget()
    return np.array(stamps), np.array(poses), odometer


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "arduino" else []) for name in PROTOCOLS]
)
def test_odometry_follows_the_driven_path(bench: MakeBench, name: str) -> None:
    robot = bench(base=name)
    host, protocol = started(robot, name)
    stamps, poses, odometer = dead_reckon(robot, host, protocol, 12.0)
    truth = robot.emulator.motion
    begin, end = truth.poses(stamps[[0, -1]])
    travelled = between(begin, end)
    assert np.hypot(*travelled[:2]) > 2.0
    # A reading is up to 25 ms old when it is processed, which is 12 mm; a count is 0.44 mm, and 2 mrad of a turn.
    assert poses[-1] == pytest.approx(travelled, abs=0.03)
    assert protocol.counters.skipped == protocol.counters.bad == protocol.counters.lost == 0
    assert odometer.counters.resets == odometer.counters.jumps == odometer.counters.gyro_jumps == 0
    period = BASE_VARIANTS[name].period
    if period is not None:
        assert len(stamps) == pytest.approx(12.0 / period, rel=0.02)


def test_wheels_have_the_reported_biases(bench: MakeBench) -> None:
    robot = bench(base="create2", seed=3, drive="base", wheels=WheelModel(slip=0.0, encoder=0.0))
    host, protocol = started(robot, "create2")
    host.write(protocol.drive(Velocity(0.3, 0.0)))
    _, poses, _ = dead_reckon(robot, host, protocol, 5.0)
    biases: Any = robot.emulator.base.report()["biases"]
    travelled, _ = robot.emulator.motion.travelled(robot.time)
    distance = np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()
    assert distance / travelled == pytest.approx((biases["left"] + biases["right"]) / 2, abs=0.01)
    assert abs(biases["left"] - 1.0) > 0.015  # with this seed


@pytest.mark.parametrize("name", PROTOCOLS)
def test_velocities_are_driven(bench: MakeBench, name: str) -> None:
    robot = bench(base=name, drive="base")
    host, protocol = started(robot, name)
    start = robot.emulator.motion.poses(np.array([robot.time]))[0]
    for _ in range(10):
        host.write(protocol.drive(Velocity(0.2, 0.5)))
        robot.go(0.2)
    travelled, turned = robot.emulator.motion.travelled(robot.time)
    assert travelled == pytest.approx(0.2 * (2.0 - 0.2 / 0.6 / 2), abs=0.02)  # acceleration of 0.6 m/s^2
    assert turned == pytest.approx(0.5 * (2.0 - 0.5 / 4.0 / 2), abs=0.03)
    assert np.hypot(*between(start, robot.emulator.motion.poses(np.array([robot.time]))[0])[:2]) > 0.3
    host.write(protocol.drive(Velocity(0.0, 0.0)) + protocol.end())
    robot.go(1.0)
    at_rest = robot.emulator.motion.travelled(robot.time)
    robot.go(0.5)
    assert robot.emulator.motion.travelled(robot.time) == at_rest


def test_a_base_without_new_commands_stops(bench: MakeBench) -> None:
    robot = bench(base="wheels", drive="base")
    host, protocol = started(robot, "wheels")
    host.write(protocol.drive(Velocity(0.2, 0.0)))
    robot.go(2.0)
    assert 0.03 < robot.emulator.motion.travelled(robot.time)[0] < 0.15


def test_walls_stop_the_robot(bench: MakeBench) -> None:
    robot = bench(base="create2", drive="base")
    host, protocol = started(robot, "create2")
    host.write(protocol.drive(Velocity(0.5, 0.0)))
    robot.step = 0.02
    robot.go(30.0)
    x, y, _ = robot.emulator.motion.poses(np.array([robot.time]))[0]
    assert clearance(x, y, robot.emulator.motion.world) == pytest.approx(ROBOT_RADIUS, abs=0.02)
    host.write(protocol.drive(Velocity(-0.3, 0.0)))
    robot.go(1.0)
    assert robot.emulator.motion.travelled(robot.time)[0] > 0.5
    x, y, _ = robot.emulator.motion.poses(np.array([robot.time]))[0]
    assert clearance(x, y, robot.emulator.motion.world) > ROBOT_RADIUS + 0.1


def test_a_create_is_silent_until_it_is_started_and_after_it_is_stopped(bench: MakeBench) -> None:
    robot = bench(base="create2")
    host = robot.open("base")
    robot.go(0.5)
    assert host.data == b""
    host.write(Create2().start())
    robot.go(0.5)
    assert len(host.data) == pytest.approx(0.5 / 0.015 * 9, abs=18)
    host.write(Create2().end())
    robot.go(0.1)
    host.forget()
    robot.go(0.5)
    assert host.data == b""


@pytest.mark.parametrize("name", ["arduino", "wheels"])
def test_opening_the_port_restarts_an_arduino(bench: MakeBench, name: str) -> None:
    robot = bench(base=name)
    robot.go(5.0)  # the robot has moved by now
    protocol = PROTOCOLS[name]()
    host = robot.open("base", protocol.baud)
    robot.go(ARDUINO_BOOT_DURATION - 0.1)
    host.write(protocol.poll())
    assert host.data == b""
    robot.go(0.2)
    host.write(protocol.poll())
    robot.go(0.1)
    first = protocol.feed(host.data)[0]
    assert 0 <= min(first.left, first.right) <= max(first.left, first.right) < 1.7 * 0.5 * 5000
    assert robot.emulator.base.device.restarts == 1


def test_a_drifting_base_sends_at_its_own_rate(bench: MakeBench) -> None:
    robot = bench(base="kobuki", base_drift=10_000.0)
    host, protocol = started(robot, "kobuki")
    robot.go(4.0)
    readings = protocol.feed(host.data)
    assert len(readings) == pytest.approx(4.0 * 50 * 1.01, abs=1.1)
    assert {b.time - a.time for a, b in pairwise(readings)} <= {20, 20 - 65536}


def test_the_same_seed_drives_the_same_counts(bench: MakeBench) -> None:
    streams = []
    for step in (0.002, 0.005):
        robot = bench(base="kobuki", seed=5, wheels=WheelModel())
        robot.step = step
        host = robot.open("base")
        robot.go(3.0)
        streams.append(host.data)
    assert streams[0] == streams[1]


def test_arrow_keys_steer() -> None:
    velocity = apply_keys(Velocity(0.0, 0.0), b"\x1b[A\x1b[AW\x1b[D?")
    assert velocity == Velocity(pytest.approx(0.3), pytest.approx(0.25))
    assert apply_keys(velocity, b"\x1bOCd") == Velocity(velocity.speed, pytest.approx(-0.25))
    assert apply_keys(velocity, b"\x1b[B" * 50).speed == -0.5
    assert apply_keys(velocity, b" ") == Velocity(0.0, 0.0)


def test_keys_of_a_terminal_drive_the_robot(bench: MakeBench, monkeypatch: pytest.MonkeyPatch) -> None:
    keys, terminal = pty.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        before = termios.tcgetattr(terminal)
        robot = bench(drive="keyboard")
        robot.go(0.1)
        os.write(keys, b"\x1b[A\x1b[A")
        robot.go(2.0)
        os.write(keys, b" ")
        robot.go(0.5)
        assert robot.emulator.motion.travelled(robot.time)[0] == pytest.approx(0.2 * 1.9, abs=0.03)
        robot.emulator.__exit__(None, None, None)
        assert termios.tcgetattr(terminal) == before
    os.close(keys)


def test_the_motion_is_smooth_while_old_steps_are_discarded(bench: MakeBench) -> None:
    motion = bench().emulator.motion
    before = motion.poses(np.array([0.0]))[0]
    for moment in np.arange(0.0, 20.0, 0.05):
        motion.advance(float(moment))
        pose = motion.poses(np.array([moment]))[0]
        assert np.hypot(*between(before, pose)[:2]) < 0.05
        before = pose

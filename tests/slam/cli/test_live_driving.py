"""Driving with `wclm live`: keys of a terminal move the emulated robot, and nothing else does."""

from __future__ import annotations

import os
import pty
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.devices.driving import DriveLimits
from slam.cli import teleoperation
from slam.cli.teleoperation import COMMAND_PERIOD, KEY_TIMEOUT, Teleoperation
from slam.evaluation.metrics import score_reference
from slam.io.output_dir import TRAJECTORY
from slam.io.tum import read_tum

from ..robot import SLOW_LIDAR, LiveRun, Robot
from .test_live_saving import use_as_terminal

UP, LEFT = b"\x1b[A", b"\x1b[D"


def hold(terminal: int, key: bytes, seconds: float) -> None:
    """Write a key as often as a terminal repeats it."""
    for _ in range(round(seconds / 0.1)):
        os.write(terminal, key)
        time.sleep(0.1)


def test_keys_drive_the_robot_and_a_lost_terminal_stops_it(tmp_path: Path) -> None:
    terminal, inner = pty.openpty()
    with Robot(tmp_path, "room", "--drive", "base", *SLOW_LIDAR) as robot:
        options = ("--no-review", "--drive", "--max-speed", "0.3", "--web")
        run = LiveRun(robot, tmp_path / "map", *options, stdin=inner, preexec_fn=use_as_terminal)
        os.close(inner)
        assert run.line("wclm: driving at ") == "0.3 m/s and 1 rad/s at most"
        page = run.line("wclm: open in a browser: ")
        with urllib.request.urlopen(page, timeout=20.0) as response:
            assert response.status == 200
        hold(terminal, UP, 1.5)
        hold(terminal, LEFT, 1.3)
        time.sleep(1.6 * KEY_TIMEOUT)  # it stops without keys
        hold(terminal, UP, 0.8)
        os.close(terminal)
        status, _, err = run.wait()
        time.sleep(0.5)
        report = robot.stop()
    assert (status, "Traceback" in err) == (0, False), err
    truth = read_tum(robot.truth)
    speeds = np.hypot(*np.diff(truth.poses[:, :2], axis=0).T) / np.diff(truth.stamps)
    assert 0.4 < np.sum(speeds * np.diff(truth.stamps)) < 1.5
    assert 0.28 < speeds.max() < 0.32
    assert speeds[-10:].max() == 0.0  # it is at rest at the end
    moving = np.flatnonzero(speeds > 0.01)
    assert np.diff(moving).max() > 10  # and in between
    assert np.ptp(np.unwrap(truth.poses[:, 2])) > 1.0
    assert report["base"]["velocities"] > 20
    figures = score_reference(read_tum(run.out / TRAJECTORY), truth).figures()
    assert figures["ate_rmse"] < 0.05
    assert run.summary["walls"] >= 4


class FakeRobot:
    def __init__(self) -> None:
        self.commands: list[tuple[float, float]] = []

    def drive(self, speed: float, turn_rate: float) -> None:
        self.commands.append((speed, turn_rate))


def test_keys_are_directions_until_they_are_released(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(teleoperation.time, "monotonic", lambda: now[0])
    robot = FakeRobot()
    keys = Teleoperation(robot, DriveLimits(0.2, 1.0))

    def after(seconds: float, pressed: bytes = b"") -> list[tuple[float, float]]:
        now[0] += seconds
        robot.commands.clear()
        keys.handle(pressed)
        return list(robot.commands)

    assert after(0.0) == []
    assert after(0.0, b"s") == []
    assert after(0.0, UP) == [(0.2, 0.0)]
    assert after(COMMAND_PERIOD / 2) == []
    assert after(COMMAND_PERIOD) == [(0.2, 0.0)]
    assert after(0.0, b"\x1bOD") == [(0.0, 1.0)]  # as terminals in application mode send it
    assert after(KEY_TIMEOUT + 0.01) == [(0.0, 0.0)]
    assert after(1.0) == []
    for key, command in {b"\x1b[H": (0.2, 1.0), b"\x1b[5~": (0.2, -1.0), b"\x1b[B": (-0.2, 0.0)}.items():
        assert after(0.1, key) == [command]
    assert after(0.0, UP + b" " + UP) == [(0.0, 0.0)]
    assert after(0.0, b" ") == [(0.0, 0.0)]


def test_invalid_options_of_driving_are_refused(wclm: Any) -> None:
    lidar, base = ("--lidar", "ld06:/dev/nothing"), ("--base", "kobuki:/dev/void")
    run = ("live", *lidar, "--out", "map")
    wclm.refuses(*run, "--drive", because=["exactly one wheel base; 0 are given"])
    wclm.refuses(*run, *base, "--drive", "--max-speed", "0", because=["above 0"])
    wclm.refuses(*run, *base, "--max-turn-rate", "1", because=["without --drive"])
    wclm.refuses(*run, *base, "--drive", because=["standard input is not a terminal"])
    for address in ("127.0.0.1:0", "a:b:c", "127.0.0.1:99999", ""):
        wclm.refuses(*run, *base, "--web-address", address, because=["must be HOST or HOST:PORT"])
    wclm.refuses(
        *run, *base, "--web-address", "192.0.2.1", because=["192.0.2.1: the page cannot be served at port 8090"]
    )
    wclm.refuses("ros", "--drive", because=["exactly one wheel base; 0 are given"])
    wclm.refuses("ros", "--base", "kobuki:/dev/void", "--no-odometry", because=["--base", "with --no-odometry"])

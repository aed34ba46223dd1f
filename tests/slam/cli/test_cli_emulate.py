"""`wclm emulate`."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest


def test_emulate_runs_for_a_duration(wclm: Any, tmp_path: Path) -> None:
    ports = ("--ports", "ports", "--duration", "1", "--lidar", "ld06", "--base", "kobuki")
    priority = os.sched_getscheduler(0), os.sched_getparam(0)
    result = wclm(
        "emulate", "room", *ports, "--truth", "truth.tum", "--report", "report.json", "--stall", "base@0.1:0.1"
    )
    assert result.exit_code == 0, result.output
    assert (os.sched_getscheduler(0), os.sched_getparam(0)) == priority
    assert result.stdout.splitlines()[:2] == ["ports/lidar: ld06, 230400 baud", "ports/base: kobuki, 115200 baud"]
    assert not list((tmp_path / "ports").iterdir())
    report = json.loads((tmp_path / "report.json").read_text())
    seconds = report["seconds"]  # less than the duration if the last step came early, as on a busy computer
    assert seconds > 0.2
    assert len((tmp_path / "truth.tum").read_text().splitlines()) == pytest.approx(50 * seconds, abs=2)
    assert report["base"]["stalls"] == 1
    assert report["base"]["readings"] >= 50 * seconds - 2


def test_invalid_robots_are_refused(wclm: Any) -> None:
    wclm.refuses("emulate", "moon", because=["moon: no such world"])
    wclm.refuses("emulate", "room", "--lidar", "eyes", because=["no lidar 'eyes'; there are rplidar-a1"])
    wclm.refuses(
        "emulate",
        "room",
        "--unplug",
        "lidar@3",
        because=["--unplug lidar@3: expected the device (lidar or base) and seconds, for example lidar@20:3"],
    )
    wclm.refuses("emulate", "room", "--ports", "p", "--drive", "keyboard", because=["no keyboard"])
    assert wclm("emulate", "room", "--drop", "2").exit_code == 2


@pytest.mark.parametrize(
    ("how", "status"), [(signal.SIGINT, 0), pytest.param(signal.SIGTERM, 128 + signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_emulate_cleans_up_on_signals(tmp_path: Path, how: signal.Signals, status: int) -> None:
    # In the background of a shell SIGINT is ignored, which child processes inherit.
    program = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from slam.cli import main; main()"
    )
    options = ["emulate", "room", "--ports", "ports", "--report", "report.json"]
    running = subprocess.Popen(
        [sys.executable, "-c", program, *options],
        cwd=tmp_path,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    begun = time.monotonic()
    while not (tmp_path / "ports" / "base").is_symlink() and time.monotonic() < begun + 200.0:
        time.sleep(0.05)
    time.sleep(0.3)
    running.send_signal(how)
    _, errors = running.communicate(timeout=120.0)
    assert (running.returncode, errors.strip()) == (status, "")
    assert not list((tmp_path / "ports").iterdir())
    assert json.loads((tmp_path / "report.json").read_text())["lidar"]["restarts"] == 0

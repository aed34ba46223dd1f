"""Minutes of driving at the devices' true pace, without faults and with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.messages import Scan
from drivers.recordings.mcap import McapReader
from slam.evaluation.metrics import score_reference
from slam.io.output_dir import TRAJECTORY
from slam.io.tum import read_tum

from ..robot import LiveRun, Robot

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

FIVE_MINUTES = 300.0
"""Seconds."""
DAMAGE = 1e-4 / 3
"""Of bytes dropped, of bytes inserted and of bytes flipped: together one in ten thousand."""


def drive(folder: Path, seconds: float, *faults: str) -> tuple[LiveRun, dict[str, Any], float]:
    """The run, what the emulator says that happened, and the error (metres, ATE RMSE)."""
    with Robot(folder, "office", *faults) as robot:
        recording = str(folder / "drive.mcap")
        run = LiveRun(robot, folder / "map", "--record", recording, "--duration", str(seconds), "--no-serve")
        status, _, err = run.wait(seconds + 200.0)
        report = robot.stop()
    assert status == 0, err
    assert "Traceback" not in err
    figures = score_reference(read_tum(run.out / TRAJECTORY), read_tum(robot.truth)).figures()
    return run, report, figures["ate_rmse"]


def test_five_minutes_in_the_office(tmp_path: Path) -> None:
    run, report, error = drive(tmp_path, FIVE_MINUTES)
    assert error < 0.05
    assert run.processor < 0.6 * FIVE_MINUTES
    lidar, base = run.counters(0), run.counters(1)
    beginnings = np.array([message.stamp for message in McapReader(tmp_path / "drive.mcap") if isinstance(message, Scan)])
    assert np.diff(beginnings).max() < 0.15  # of revolutions of 0.1 s none is missing
    assert len(beginnings) == lidar["revolutions"] == run.summary["scans"]
    assert report["lidar"]["samples"] - lidar["samples"] < lidar["samples"] / lidar["revolutions"]
    assert report["base"]["readings"] - base["good"] < 10
    assert run.summary["skipped"]["messages"] == 0


def test_damage_an_unplugged_lidar_and_one_that_restarts(tmp_path: Path) -> None:
    damage = [text for kind in ("drop", "insert", "flip") for text in (f"--{kind}", str(DAMAGE))]
    run, report, error = drive(tmp_path, 180.0, *damage, "--unplug", "lidar@60:3", "--restart", "lidar@120")
    assert error < 0.10
    lidar, base = run.counters(0), run.counters(1)
    assert (report["lidar"]["unplugs"], report["lidar"]["restarts"]) == (1, 1)
    assert (lidar["connections"], lidar["losses"]) == (3, 2)
    # A fault damages one packet, seldom two; and two faults may damage the same one.
    damaged = sum(report["lidar"][kind] for kind in ("dropped", "inserted", "flipped"))
    assert 0.9 * damaged < lidar["checksum_failures"] < 1.1 * damaged
    spoilt = sum(report["base"][kind] for kind in ("dropped", "inserted", "flipped"))
    assert 0.5 * spoilt <= report["base"]["readings"] - base["good"] <= 1.5 * spoilt + 5
    assert base["bad"] + base["lost"] >= 0.5 * spoilt
    assert base["losses"] == 0


def test_an_unplugged_base(tmp_path: Path) -> None:
    run, report, error = drive(tmp_path, 90.0, "--unplug", "base@60:3")
    assert error < 0.10
    assert report["base"]["unplugs"] == run.counters(1)["losses"] == 1

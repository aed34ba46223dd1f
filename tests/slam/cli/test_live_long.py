"""Live runs of minutes in real time, with and without faults."""

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
"""Duration in seconds."""
CORRUPTION = 1e-4 / 3
"""Share of bytes dropped, inserted and flipped each: one in ten thousand together."""


def drive(folder: Path, seconds: float, *faults: str) -> tuple[LiveRun, dict[str, Any], float]:
    """Return the run, the report of the emulator, and the error of the path (metres, ATE RMSE)."""
    with Robot(folder, "office", *faults) as robot:
        recording = str(folder / "drive.mcap")
        run = LiveRun(robot, folder / "map", "--record", recording, "--duration", str(seconds), "--no-serve")
        status, _, err = run.wait(seconds + 200.0)
        report = robot.stop()
    assert status == 0, err
    assert "Traceback" not in err
    figures = score_reference(read_tum(run.out / TRAJECTORY), read_tum(robot.truth)).figures()
    return run, report, figures["ate_rmse"]


def test_five_minutes_without_faults(tmp_path: Path) -> None:
    run, report, error = drive(tmp_path, FIVE_MINUTES)
    assert error < 0.05
    assert run.cpu_seconds < 0.6 * FIVE_MINUTES
    lidar, base = run.counters(0), run.counters(1)
    scan_stamps = np.array(
        [message.stamp for message in McapReader(tmp_path / "drive.mcap") if isinstance(message, Scan)]
    )
    assert np.diff(scan_stamps).max() < 0.15  # no revolution of 0.1 s is missing
    assert len(scan_stamps) == lidar["revolutions"] == run.summary["scans"]
    assert report["lidar"]["samples"] - lidar["samples"] < lidar["samples"] / lidar["revolutions"]
    assert report["base"]["readings"] - base["good"] < 10
    assert run.summary["skipped"]["messages"] == 0


def test_corrupted_bytes_an_unplugged_and_a_restarted_lidar(tmp_path: Path) -> None:
    corruption = [text for kind in ("drop", "insert", "flip") for text in (f"--{kind}", str(CORRUPTION))]
    run, report, error = drive(tmp_path, 180.0, *corruption, "--unplug", "lidar@60:3", "--restart", "lidar@120")
    assert error < 0.10
    lidar, base = run.counters(0), run.counters(1)
    assert (report["lidar"]["unplugs"], report["lidar"]["restarts"]) == (1, 1)
    assert (lidar["connections"], lidar["losses"]) == (3, 2)
    # A fault corrupts one packet, rarely two; two faults can corrupt the same packet.
    damaged = sum(report["lidar"][kind] for kind in ("dropped", "inserted", "flipped"))
    assert 0.9 * damaged < lidar["checksum_failures"] < 1.1 * damaged
    corrupted = sum(report["base"][kind] for kind in ("dropped", "inserted", "flipped"))
    assert 0.5 * corrupted <= report["base"]["readings"] - base["good"] <= 1.5 * corrupted + 5
    assert base["bad"] + base["lost"] >= 0.5 * corrupted
    assert base["losses"] == 0


def test_an_unplugged_base_is_connected_again(tmp_path: Path) -> None:
    run, report, error = drive(tmp_path, 90.0, "--unplug", "base@60:3")
    assert error < 0.10
    assert report["base"]["unplugs"] == run.counters(1)["losses"] == 1

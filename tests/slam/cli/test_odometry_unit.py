"""`wclm run` with a recording whose odometry is in millimetres."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import Odometry, Scan
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LidarModel, Simulation
from slam.io.output_dir import SUMMARY

DOUBT = "odometry is faster than 30 m/s wherever it moves, as if in millimetres or centimetres"


@pytest.mark.slow
def test_odometry_in_millimetres_is_named_and_not_used(wclm: Any, tmp_path: Path) -> None:
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for message in Simulation("office", seed=2, duration=12.0, lidar=LidarModel(beams=180)):
            if isinstance(message, Odometry):
                message = replace(message, pose=message.pose * np.array([1000.0, 1000.0, 1.0]))
            if isinstance(message, Odometry | Scan):
                writer.write(message)
    result = wclm("run", "drive.mcap", "--out", "map", "--no-review")
    assert result.exit_code == 0, result.output
    assert f"drive.mcap: {DOUBT}: motions are predicted" in " ".join(result.stderr.split())
    assert f"warning    {DOUBT}" in result.stdout
    assert json.loads((tmp_path / "map" / SUMMARY).read_text())["doubts"] == [DOUBT]
    assert DOUBT[1:] in (tmp_path / "map" / "report.html").read_text()

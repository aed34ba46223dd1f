"""Opening sources from paths and specifications; errors are one line of text."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import RecordingError
from drivers.simulation import Simulation
from drivers.source_factory import LidarSelection


def test_options_of_a_simulation_are_parsed() -> None:
    source = drivers.open("sim:room?seed=3&duration=12.5&mount=0.1,0.2,-0.5")
    assert isinstance(source, Simulation)
    assert (source.seed, source.duration) == (3, 12.5)
    assert np.array_equal(source.mount, [0.1, 0.2, -0.5])
    assert source.name == "sim:room"
    low_cost = drivers.open("sim:room?lidar=short&odometry=bad")
    assert isinstance(low_cost, Simulation)
    assert low_cost.lidar.range_max < source.lidar.range_max
    assert low_cost.wheels.scale_bias > source.wheels.scale_bias


def test_directory_without_metadata_is_read_if_it_has_one_file(tmp_path: Path, recordings: dict[str, str]) -> None:
    for file in Path(recordings["ros2-mcap"]).glob("*.mcap"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    assert sum(isinstance(message, drivers.Scan) for message in drivers.open(tmp_path)) == 29


@pytest.mark.parametrize("name", ["drive.mcap", "drive.bag", "drive.db3"])
def test_an_empty_recording_is_called_empty(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with pytest.raises(RecordingError, match=f"{name}: is empty"):
        drivers.open(tmp_path / name)


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        ("nothing.clf", "no such file"),
        ("a.xyz", r"extension \.xyz"),
        ("plain", "without extension"),
        ("folder", "not a ROS 2 bag"),
        ("sim:nowhere", "no such world"),
        ("sim:room?seed=many", "seed must be a whole number, not 'many'"),
        ("sim:room?seed=1.5", r"seed must be a whole number, not '1\.5'"),
        ("sim:room?duration=", "duration must be a number, not ''"),
        ("sim:room?mount=1,b,2", "mount must be a number, not 'b'"),
        ("sim:room?speed=3", "unknown option speed"),
        ("sim:room?duration=-3", "duration"),
        ("sim:room?lidar=best", "no lidar 'best'; choose one of long, short, half"),
        ("sim:room?second_mount=1,2", "mount must be three finite numbers"),
        ("sim:room?odometry=", "no odometry ''; choose one of good, bad"),
    ],
)
def test_invalid_specifications_are_one_line_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spec: str, reason: str
) -> None:
    (tmp_path / "a.xyz").write_text("x")
    (tmp_path / "plain").write_text("x")
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RecordingError, match=reason) as caught:
        drivers.open(spec)
    text = str(caught.value)
    assert "\n" not in text
    if not spec.startswith("sim:") and reason != "no such file":
        assert "CARMEN" in text
        assert ".mcap" in text


def test_importing_drivers_loads_no_heavy_library() -> None:
    heavy = {"numba", "rosbags", "mcap", "pydantic", "gtsam", "rerun"}
    code = f"import sys, drivers; sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_topics_of_what_has_none_are_errors(tmp_path: Path) -> None:
    log = tmp_path / "drive.clf"
    log.write_text("")
    for source in (log, "sim:room"):
        with pytest.raises(RecordingError, match="has no topics, so none is named /scan"):
            drivers.open(source, LidarSelection("/scan"))

"""Recordings of earlier runs are opened again as they were mapped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.messages import Scan
from slam.config import Config, SecondLidarConfig, config_to_toml
from slam.errors import MapError
from slam.io.output_dir import CONFIG
from slam.io.recordings import open_recording, recording_to_reopen
from slam.io.run_results import RunResults
from slam.io.tum import Trajectory
from slam.mapping.map_features import MapCorners, MapWalls

NONE = np.zeros(0)
NO_WALLS = MapWalls(np.zeros(0, int), np.zeros((0, 3)), NONE, NONE, np.zeros(0, int), np.zeros((0, 2, 2)), ())
NO_CORNERS = MapCorners(
    np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros(0, int)
)
ROOM = "sim:room?duration=1"
TURNED = [0.0, 0.0, 3.0]


def results(folder: Path, *recordings: dict[str, object]) -> RunResults:
    """Return results of recordings of the room."""
    (folder / CONFIG).write_text(config_to_toml(Config()))
    summary = {"recordings": [{"name": "room", "path": ROOM} | recording for recording in recordings]}
    return RunResults(folder, NO_WALLS, NO_CORNERS, Trajectory(np.zeros(1), np.zeros((1, 3))), summary, None)


def test_scans_of_each_recording_have_the_mount_with_which_they_were_mapped(tmp_path: Path) -> None:
    """The settings of merged sessions are those of the first; what a run has found is in no settings."""
    opened = results(tmp_path, {"mounts": [TURNED]}, {"mounts": [None], "shift": 10.0})
    (tmp_path / CONFIG).write_text(config_to_toml(Config().with_mount((0.0, 0.0, 1.0))))
    assert opened.config_as_used().mounts() == [None]
    headings = [message.mount[2] for message in open_recording(opened) if isinstance(message, Scan)]
    assert headings[0] == 3.0
    assert headings[-1] == 0.0
    assert len(set(headings)) == 2


@pytest.mark.parametrize("mounts", [["left"], [[0.0, 1.0]], [[0.0, 1.0, None]], 3, [{"x": 1.0}]])
def test_invalid_mounts_are_one_line_errors(tmp_path: Path, mounts: object) -> None:
    with pytest.raises(MapError, match="mounts of a recording in its summary must have x, y and heading"):
        open_recording(results(tmp_path, {"mounts": mounts}))


@pytest.mark.parametrize("recordings", [({},), ({"mounts": [TURNED]}, {})])
def test_results_of_older_versions_state_no_mounts(tmp_path: Path, recordings: tuple[dict[str, object], ...]) -> None:
    opened = results(tmp_path, *recordings)
    (tmp_path / CONFIG).write_text(config_to_toml(Config().with_mount((0.0, 0.0, 1.0))))
    assert opened.config_as_used().mounts() == [(0.0, 0.0, 1.0)]


def test_delays_that_a_run_has_found_are_those_of_its_settings_unless_these_state_others(tmp_path: Path) -> None:
    found = results(tmp_path, {})
    found.summary.update(timing={"compensated_delay": 0.1}, second_timing={"compensated_delay": 0.4})
    assert found.config_as_used().second_lidar_delay == pytest.approx(0.3)
    (tmp_path / CONFIG).write_text(config_to_toml(Config(second_lidar=SecondLidarConfig(delay=0.2))))
    assert found.config_as_used().second_lidar_delay == pytest.approx(0.1)
    found.summary.update(timing=None, second_timing={"compensated_delay": "late"})
    assert found.config_as_used().lidar.delay is None


def test_a_replay_is_opened_again_as_its_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert recording_to_reopen("replay:a.mcap?speed=20") == recording_to_reopen("a.mcap") == str(tmp_path / "a.mcap")
    assert recording_to_reopen(ROOM) == ROOM

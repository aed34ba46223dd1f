"""Recordings of earlier runs are opened again as they were mapped."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from drivers.messages import Scan
from drivers.recordings.mcap import McapWriter
from drivers.simulation import Simulation
from slam.config import Config, LidarConfig, OdometryConfig, SecondLidarConfig, config_to_toml
from slam.errors import ConfigurationError, MapError
from slam.io.json_files import to_json_types
from slam.io.output_dir import CONFIG
from slam.io.recordings import open_recording, recording_to_reopen
from slam.io.run_results import RunResults
from slam.io.sessions import Recording
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


def scans(opened: RunResults) -> list[Scan]:
    return [message for message in open_recording(opened) if isinstance(message, Scan)]


def read_with(lidar: LidarConfig) -> dict[str, object]:
    """Return the entry of a recording that was read with these settings."""
    return {"settings": to_json_types(Config(lidar=lidar).of_recording())}


def test_scans_of_each_recording_are_as_they_were_used(tmp_path: Path) -> None:
    """The settings of merged sessions are those of the first; what a run has found is in no settings."""
    usual, near = LidarConfig(range_max=math.inf), LidarConfig(range_max=2.0, range_bias=0.1, mount=(0.1, 0.0, 3.0))
    opened = results(tmp_path, read_with(usual), read_with(near) | {"shift": 10.0})
    (tmp_path / CONFIG).write_text(config_to_toml(Config().with_mount((0.0, 0.0, 1.0))))
    read = scans(opened)
    first, second = read[0], read[len(read) // 2]
    assert first.mount is not None
    assert second.mount is not None
    assert (first.mount[2], second.mount.tolist()) == (0.0, [0.1, 0.0, 3.0])
    assert second.stamp == first.stamp + 10.0
    beyond = first.ranges > 2.0
    np.testing.assert_array_equal(second.ranges[~beyond], first.ranges[~beyond] - 0.1)
    assert np.isnan(second.ranges[beyond]).all()
    assert beyond.any()


def test_a_second_lidar_of_each_recording_has_its_own_delay(tmp_path: Path) -> None:
    drive = list(Simulation("room", duration=0.5, second_mount=(0.0, 0.0, 3.0)))
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for message in drive:
            writer.write(message)
    both = Config().with_two_lidars("/scan", "/scan_2")
    late = both.model_copy(update={"second_lidar": SecondLidarConfig(topic="/scan_2", delay=0.3)})
    entries = [{"path": str(tmp_path / "drive.mcap"), "settings": one.of_recording()} for one in (both, late)]
    rear = [scan.stamp for scan in scans(results(tmp_path, *entries)) if scan.lidar]
    half = len(rear) // 2
    assert np.subtract(rear[:half], rear[half:]) == pytest.approx(0.3)


def test_settings_of_a_recording_are_restored(tmp_path: Path) -> None:
    config = Config(odometry=OdometryConfig(topic="/odom"), lidar=LidarConfig(range_max=math.inf, delay=0.1))
    entry = Recording(name="room", path=ROOM, first=0.0, last=1.0, settings=config)
    text = json.dumps(entry.model_dump(), allow_nan=False)
    assert Recording.model_validate_json(text).settings == config
    assert results(tmp_path).settings_as_used(json.loads(text)) == config


@pytest.mark.parametrize("mounts", [["left"], [[0.0, 1.0]], [[0.0, 1.0, None]], 3, [{"x": 1.0}]])
def test_invalid_mounts_are_one_line_errors(tmp_path: Path, mounts: object) -> None:
    with pytest.raises(ConfigurationError, match=r"summary.json: mounts of a recording: lidar.mount"):
        open_recording(results(tmp_path, {"mounts": mounts}))


@pytest.mark.parametrize("settings", [None, 3, {"lidar": {"delay": "late"}}])
def test_invalid_settings_are_one_line_errors(tmp_path: Path, settings: object) -> None:
    with pytest.raises(ConfigurationError, match=r"summary.json: settings of a recording: [^\n]+$"):
        open_recording(results(tmp_path, {"settings": settings}))


def test_results_of_older_versions_state_mounts_or_nothing(tmp_path: Path) -> None:
    opened = results(tmp_path, {"mounts": [TURNED]}, {"mounts": [None]}, {})
    (tmp_path / CONFIG).write_text(config_to_toml(Config().with_mount((0.0, 0.0, 1.0))))
    mounts = [opened.settings_as_used(recording).lidar.mount for recording in opened.recordings()]
    assert mounts == [tuple(TURNED), None, (0.0, 0.0, 1.0)]


def test_delays_of_older_versions_are_those_that_the_run_has_found_or_set(tmp_path: Path) -> None:
    found = results(tmp_path, {})
    found.summary.update(timing={"compensated_delay": 0.1}, second_timing={"compensated_delay": 0.4})
    assert found.settings_as_used({}).second_lidar_delay == pytest.approx(0.3)
    (tmp_path / CONFIG).write_text(config_to_toml(Config(second_lidar=SecondLidarConfig(delay=0.2))))
    assert found.settings_as_used({}).second_lidar_delay == pytest.approx(0.1)
    found.summary.update(timing=None, second_timing={"compensated_delay": "late"})
    assert found.settings_as_used({}).lidar.delay is None


def test_a_recording_that_was_moved_has_the_shift_of_its_stamps(tmp_path: Path) -> None:
    usual = scans(results(tmp_path, {}))
    moved = open_recording(results(tmp_path, {"path": "/gone.mcap", "shift": 10.0}), ROOM)
    stamps = [message.stamp for message in moved if isinstance(message, Scan)]
    assert stamps == [scan.stamp + 10.0 for scan in usual]


def test_another_file_takes_the_place_of_the_recording_that_is_missing(tmp_path: Path) -> None:
    here, gone = {"shift": 0.0}, {"path": "/gone.mcap", "shift": 10.0}
    moved = open_recording(results(tmp_path, here, gone), ROOM)
    both = scans(results(tmp_path, here, here | {"shift": 10.0}))
    assert [message.stamp for message in moved if isinstance(message, Scan)] == [scan.stamp for scan in both]
    for recordings, count in (
        ((here, here), "none of its 2 recordings is"),
        ((gone, gone), "2 of its 2 recordings are"),
    ):
        with pytest.raises(MapError, match=f"the place of one missing recording, but {count} missing"):
            open_recording(results(tmp_path, *recordings), ROOM)


def test_a_replay_is_opened_again_as_its_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert recording_to_reopen("replay:a.mcap?speed=20") == recording_to_reopen("a.mcap") == str(tmp_path / "a.mcap")
    assert recording_to_reopen(ROOM) == ROOM

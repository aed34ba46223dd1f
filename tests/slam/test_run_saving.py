"""A run of a program is saved as `wclm run` saves it: commands read it, and another run continues it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slam
from drivers.messages import Message
from drivers.simulation import Simulation
from slam.config import Config, LidarConfig, load_config
from slam.errors import MessageError, OutputError
from slam.evaluation.metrics import read_relations
from slam.io.exports import write_pgm, write_pgm_yaml
from slam.io.keyframes_csv import read_keyframes
from slam.io.map_json import read_map
from slam.io.output_dir import CONFIG, KEYFRAMES, MAP
from slam.io.run_results import read_run_results
from slam.io.sessions import read_session
from slam.io.tum import read_tum, write_tum
from slam.io.wall_maps import read_wall_map

ROOM = "sim:room?duration=10&seed=2&lidar=short"


@pytest.fixture(scope="module")
def messages() -> list[Message]:
    return list(Simulation("room", seed=3, duration=14.0))


def save(pipeline: slam.Slam, messages: Sequence[Message], directory: Path) -> slam.Finished:
    for message in messages:
        pipeline.add(message)
    finished = pipeline.finish()
    slam.save_run(pipeline, finished, directory, name="own robot")
    return finished


def later(messages: Sequence[Message]) -> list[Message]:
    return [replace(message, stamp=message.stamp + 1000.0) for message in messages]


def test_files_are_named_by_paths_or_text(tmp_path: Path) -> None:
    mapped = slam.run("sim:room?duration=3")
    directory, grid, relations = str(tmp_path / "saved"), str(tmp_path / "grid"), tmp_path / "room.relations"
    mapped.save(directory)
    relations.write_text("0 1 0.1 0 0 0 0 0\n")
    write_pgm(f"{grid}.pgm", mapped.occupancy())
    write_pgm_yaml(f"{grid}.yaml", mapped.occupancy(), "grid.pgm")
    write_tum(f"{grid}.tum", mapped.trajectory)
    assert load_config(f"{directory}/{CONFIG}") == mapped.config
    assert len(read_map(f"{directory}/{MAP}").walls) == len(read_run_results(directory).walls) == len(mapped.walls)
    assert len(read_keyframes(f"{directory}/{KEYFRAMES}")) == len(mapped.keyframes)
    assert len(read_tum(f"{grid}.tum").stamps) == len(mapped.stamps)
    assert len(read_wall_map(directory).walls) == len(mapped.walls)
    assert read_session(directory).latest == mapped.stamps[-1]
    assert len(read_relations(str(relations))) == 1


def test_a_saved_recording_has_the_files_of_wclm_run(wclm: Any, tmp_path: Path) -> None:
    slam.run(ROOM).save(tmp_path / "saved")
    assert wclm("run", ROOM, "--out", "map", "--no-review").exit_code == 0
    files = {path.relative_to(tmp_path / "map") for path in (tmp_path / "map").rglob("*") if path.is_file()}
    assert files == {path.relative_to(tmp_path / "saved") for path in (tmp_path / "saved").rglob("*") if path.is_file()}
    for file in files:
        if file.name not in ("summary.json", "report.html"):  # which have times
            assert (tmp_path / "map" / file).read_bytes() == (tmp_path / "saved" / file).read_bytes(), file
    assert wclm("map", "saved", "--format", "pgm").exit_code == 0
    ran, saved = (read_run_results(Path(name)).summary for name in ("map", "saved"))
    measured = {"slam_seconds", "wall_seconds", "real_time_factor", "peak_memory_mib", "review"}
    assert ran.keys() - saved.keys() == measured
    for name in ("scans", "odometry", "start", "duration", "keyframes", "walls", "path_length", "skipped", "lidars"):
        assert ran[name] == saved[name], name


@pytest.mark.slow
def test_all_commands_read_a_run_whose_measurements_are_not_recorded(
    wclm: Any, tmp_path: Path, messages: list[Message]
) -> None:
    finished = save(slam.Slam(keep_all_features=True), messages, tmp_path / "own")
    results = read_run_results(tmp_path / "own")
    assert len(results.walls) == len(finished.walls)
    assert results.mounts().tolist() == [[0.1, 0.0, 0.0]]
    assert "own robot" in (tmp_path / "own" / "report.html").read_text()
    for command in (
        ("map", "own", "--format", "svg"),
        ("map", "own", "--format", "pgm"),
        ("measure", "own"),
        ("report", "own", "--overwrite"),
        ("review", "own", "--summary"),
        ("optimize", "own", "--out", "better"),
        ("run", "sim:room?duration=10&seed=4", "--localize", "own", "--out", "found"),
    ):
        assert wclm(*command).exit_code == 0, command


@pytest.mark.parametrize("frozen", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_saved_run_is_continued_or_localised_in(tmp_path: Path, messages: list[Message], *, frozen: bool) -> None:
    walls = len(save(slam.Slam(), messages, tmp_path / "first").walls)
    second = slam.Slam(resumed=read_session(tmp_path / "first"), frozen=frozen)
    with pytest.raises(MessageError, match="the session that is continued ends at"):
        second.add(messages[1])  # the first one is ground truth
    finished = save(second, later(messages), tmp_path / "second")
    assert (tmp_path / "second" / "session").exists() is not frozen
    summary = read_run_results(tmp_path / "second").summary
    assert len(summary["recordings"]) == (1 if frozen else 2)
    assert summary["recordings"][-1]["first"] >= 1000.0
    assert summary["path_length"] == pytest.approx(read_run_results(tmp_path / "first").summary["path_length"], abs=0.1)
    assert np.abs(finished.poses[-1] - messages_end(tmp_path)).max() < 0.05
    assert not frozen or len(finished.walls) == walls


def messages_end(directory: Path) -> np.ndarray:
    """Return the pose at which the first run ended: the second one drives the same way."""
    return np.array(read_run_results(directory / "first").trajectory.poses[-1])


def test_earlier_results_are_replaced_only_if_allowed(tmp_path: Path, messages: list[Message]) -> None:
    pipeline = slam.Slam()
    finished = save(pipeline, messages, tmp_path / "own")
    with pytest.raises(OutputError, match="exists already"):
        slam.save_run(pipeline, finished, tmp_path / "own")
    slam.save_run(pipeline, finished, str(tmp_path / "own"), name="again", overwrite=True)
    summary = read_run_results(tmp_path / "own").summary
    assert summary["recording"] == "again"
    assert len(summary["recordings"]) == 1


def test_what_a_recording_shows_of_its_lidar_is_no_setting_of_the_next_drive(tmp_path: Path) -> None:
    """Whoever continues the session may have corrected the stamps by then."""
    mapped = slam.run("sim:room?duration=2")
    late = mapped.slam.config.model_copy(update={"lidar": LidarConfig(delay=0.3)})
    mapped.slam.config = late
    mapped.save(tmp_path / "map")
    assert load_config(tmp_path / "map" / CONFIG) == mapped.config == Config()

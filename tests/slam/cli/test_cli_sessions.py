"""Commands on sessions: `run --continue` and `--localize`, `optimize`, `map --format g2o`."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.recordings.mcap import McapReader, McapWriter
from drivers.simulation import LidarModel, Simulation
from slam.config import Config
from slam.graph.pose_graph import optimise, read_pose_graph
from slam.io.map_json import read_map
from slam.io.output_dir import MAP, REPORT, RESULTS, SESSION, SUMMARY, TRAJECTORY
from slam.io.recording_timing import RecordingTiming
from slam.io.recordings import open_recording
from slam.io.run_results import read_run_results
from slam.io.sessions import read_session
from slam.io.tum import read_tum
from slam.mapping.convergence import converge

DRIVES = {"first": (1, 0.0, 14.0), "second": (2, 7.0, 16.0)}
"""Seed, start and end time (seconds) of drives through the office, by the name of the recording."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory with recordings of the drives; the stamps of each start at the beginning of its simulation."""
    folder = tmp_path_factory.mktemp("recordings")
    for name, (seed, begin, end) in DRIVES.items():
        messages = list(Simulation("office", seed=seed, duration=end, lidar=LidarModel(beams=270, rate=5.0)))
        with McapWriter(folder / f"{name}.mcap") as writer:
            for message in messages:
                if message.stamp - messages[0].stamp >= begin:
                    writer.write(message)
    return folder


@pytest.fixture
def session(wclm: Any, folder: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """Copy of the output directory of the first drive, which is mapped once."""
    made = folder / "out"
    if not made.exists():
        result = wclm("run", folder / "first.mcap", "--out", made, "--no-review")
        assert result.exit_code == 0, result.output
    return Path(shutil.copytree(made, tmp_path / "out"))


def test_continue_extends_the_map(wclm: Any, folder: Path, session: Path) -> None:
    result = wclm("run", folder / "second.mcap", "--continue", session, "--out", "both", "--plot")
    assert result.exit_code == 0, result.output
    assert {file.name for file in Path("both").iterdir()} == RESULTS
    summary = json.loads(Path("both", SUMMARY).read_text())
    first, second = summary["recordings"]
    assert first["name"] != second["name"]
    assert second["shift"] > 0
    assert second["first"] > first["last"]
    path = read_tum(Path("both", TRAJECTORY))
    assert len(path) > len(read_tum(session / TRAJECTORY))
    assert path.stamps[-1] > first["last"]
    assert len(read_map(Path("both", MAP)).walls) > len(read_map(session / MAP).walls)
    chained = [message.stamp for message in open_recording(read_run_results(Path("both")))]
    assert chained == sorted(chained)
    assert wclm("map", "both", "--format", "ply").exit_code == 0
    assert wclm("run", folder / "second.mcap", "--continue", "both", "--out", "both", "--no-review").exit_code == 2
    again = wclm("run", folder / "first.mcap", "--continue", "both", "--out", "both", "--overwrite", "--no-review")
    assert again.exit_code == 0, again.output
    third = json.loads(Path("both", SUMMARY).read_text())
    assert len(third["recordings"]) == 3
    assert third["path_length"] == pytest.approx(json.loads((session / SUMMARY).read_text())["path_length"], rel=0.05)


@pytest.mark.slow
def test_a_recording_with_earlier_stamps_is_no_interrupted_run(wclm: Any, folder: Path, session: Path) -> None:
    """Its odometry happens to begin where that of the session ended, and the robot is somewhere else."""
    messages, last = list(McapReader(folder / "second.mcap")), read_session(session).odometry[-1].poses[-1]
    first = next(message.pose for message in messages if isinstance(message, Odometry))
    with McapWriter(Path("moved.mcap")) as writer:
        for message in messages:
            if isinstance(message, Odometry):
                message = replace(message, pose=se2.compose(last, se2.between(first, message.pose)))
            writer.write(message)
    result = wclm("run", "moved.mcap", "--localize", session, "--out", "there", "--no-review")
    assert result.exit_code == 0, result.output
    summary = json.loads(Path("there", SUMMARY).read_text())
    assert (summary["warnings"], summary["slam"]["suspects"]) == ([], [])


def test_localize_leaves_the_map_unchanged(wclm: Any, folder: Path, session: Path) -> None:
    result = wclm("run", folder / "second.mcap", "--localize", session, "--out", "there", "--no-review")
    assert result.exit_code == 0, result.output
    assert re.search(r"start +recognised in the map after \d+\.\d s", result.stdout)
    assert "LOST" not in result.stdout
    page = Path("there", REPORT).read_text()
    assert "the robot was lost" not in page
    assert "no loops were searched for" in page
    assert SESSION not in {file.name for file in Path("there").iterdir()}
    before, after = read_map(session / MAP).walls, read_map(Path("there", MAP)).walls
    np.testing.assert_array_equal(after.identity, before.identity)
    np.testing.assert_allclose(after.frame, before.frame, atol=1e-5)
    (recording,) = json.loads(Path("there", SUMMARY).read_text())["recordings"]
    stamps = read_tum(Path("there", TRAJECTORY)).stamps
    assert recording["shift"] > 1.0
    assert stamps[-1] == pytest.approx(recording["last"] - recording["shift"], abs=0.2)  # on the recording's clock
    assert stamps[0] >= recording["first"] - recording["shift"]
    assert wclm("map", "there", "--format", "ply").exit_code == 0
    wclm.refuses("run", folder / "second.mcap", "--localize", "there", "--out", "x", because=["there: has no session"])
    elsewhere = ("run", "sim:room?duration=6&lidar=short", "--localize", session, "--out", "x")
    wclm.refuses(*elsewhere, because=["sim:room", "never relocalised"])
    assert not Path("x").exists()


@pytest.mark.slow
def test_a_right_initial_pose_is_no_warning(wclm: Any, folder: Path, session: Path) -> None:
    options = ("--localize", session, "--out", "here", "--no-review")
    result = wclm("run", folder / "first.mcap", *options, "--start", "0,0,0")
    assert result.exit_code == 0, result.output
    assert "warning" not in result.stdout
    assert "recognised" not in result.stdout
    assert "LOST" not in result.stdout
    wrong = wclm("run", folder / "first.mcap", *options, "--overwrite", "--start", "5,5,2")
    assert "warning    the pose is lost" in wrong.output
    assert "LOST" in wrong.output


def test_continue_and_localize_exclude_each_other(wclm: Any, session: Path) -> None:
    result = wclm("run", "sim:room", "--localize", session, "--continue", session, "--out", "x")
    assert result.exit_code == 2
    assert "only one of the two can be given" in result.stderr


def test_optimize_refines_a_session(wclm: Any, session: Path) -> None:
    result = wclm("optimize", session, "--out", "better", "--plot")
    assert result.exit_code == 0, result.output
    for words in ("before", "after", "(median), at most by"):
        assert words in result.stdout
    assert {file.name for file in Path("better").iterdir()} == RESULTS
    summary = json.loads(Path("better", SUMMARY).read_text())
    assert summary["slam"]["refinement"]["factors_after"] == summary["slam"]["factors"]
    np.testing.assert_array_equal(read_tum(Path("better", TRAJECTORY)).stamps, read_tum(session / TRAJECTORY).stamps)
    assert len(read_session(Path("better")).scans) == len(read_session(session).scans)
    wclm.refuses("optimize", session, "--out", "better", because=["better: exists already"])


def test_optimize_needs_of_a_summary_what_every_run_writes(wclm: Any, session: Path) -> None:
    file = session / SUMMARY
    summary = json.loads(file.read_text())
    of_the_run = {"unfinished": True, "plan": {"file": "a.svg", "recognised": False}}
    least = {name: value for name, value in summary.items() if name not in ("skipped", "slam")}
    file.write_text(json.dumps(least | of_the_run))
    result = wclm("optimize", session, "--out", "better", "--no-review")
    assert result.exit_code == 0, result.output
    assert not of_the_run.keys() & read_run_results(Path("better")).summary.keys()
    without_start = json.dumps({name: value for name, value in summary.items() if name != "start"})
    summary["slam"]["odometry"]["random"]["across"] = float("nan")
    for damaged, because in (
        (without_start, "has no start, which every run writes"),
        (json.dumps(summary), "is not the summary of a run"),
    ):
        file.write_text(damaged)
        wclm.refuses("optimize", session, "--out", "worse", because=[f"{file}: {because}"])
        assert not Path("worse").exists()


def test_optimize_maps_and_refines_a_recording(wclm: Any) -> None:
    drive = "sim:room?duration=5&lidar=short"
    result = wclm("optimize", drive, "--out", "room", "--no-review")
    assert result.exit_code == 0, result.output
    assert wclm("run", drive, "--continue", "room", "--out", "more", "--no-review").exit_code == 0
    wclm.refuses("optimize", "nowhere.txt", "--out", "x", because=["nowhere.txt"])


def test_what_a_recording_shows_is_no_setting_of_its_refined_map(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after `wclm run`: the settings may be used for another robot, and scans are placed as they were."""
    monkeypatch.setattr(RecordingTiming, "of", lambda *_: RecordingTiming(used_delay=0.01))
    result = wclm("optimize", "sim:room?duration=5&lidar=short", "--out", "room", "--no-review")
    assert result.exit_code == 0, result.output
    results = read_run_results(Path("room"))
    assert results.config() == Config()
    (recording,) = results.recordings()
    assert results.settings_as_used(recording).lidar.delay == 0.01
    assert results.summary["lidars"] == [list(Simulation("room").mount)]


def test_optimize_refuses_options_that_would_have_no_effect(wclm: Any, session: Path, tmp_path: Path) -> None:
    (tmp_path / "a.g2o").write_text("")
    for settings in (("--set", "lidar.delay=0"), ("--config", "a.toml")):
        wclm.refuses("optimize", session, "--out", "x", *settings, because=["--config / --set: a session has its own"])
        wclm.refuses("optimize", "a.g2o", "--out", "x", *settings, because=["a pose graph has no settings"])
    wclm.refuses("optimize", session, "--out", "x", "--robust", because=["--robust: is for pose graphs"])
    assert not (tmp_path / "x").exists()


def test_optimize_names_what_it_cannot_refine(wclm: Any) -> None:
    assert wclm("run", "sim:room?duration=0.5", "--out", "short", "--no-review").exit_code == 0
    because = ["short: nothing to optimise: the session has fewer than two keyframes"]
    wclm.refuses("optimize", "short", "--out", "better", because=because)


def test_odometry_that_is_left_out_as_the_session_has_none_is_named(wclm: Any, tmp_path: Path) -> None:
    for name, kinds in (("alone.mcap", Scan), ("both.mcap", Scan | Odometry)):
        with McapWriter(tmp_path / name) as writer:
            for message in Simulation("room", duration=3.0, lidar=LidarModel(beams=180, rate=5.0)):
                if isinstance(message, kinds):
                    writer.write(message)
    assert wclm("run", "alone.mcap", "--out", "alone", "--no-review").exit_code == 0
    text = "both.mcap: its odometry is not used, as the session was mapped without"
    for recording, said in (("both.mcap", True), ("alone.mcap", False)):
        result = wclm("run", recording, "--continue", "alone", "--out", "longer", "--no-review", "--overwrite")
        assert result.exit_code == 0, result.output
        assert (text in result.stderr) == said


def test_an_output_directory_without_session_is_refused(wclm: Any, session: Path) -> None:
    shutil.rmtree(session / SESSION)  # as in output directories of older versions
    for command in (("optimize", session), ("run", "sim:room", "--continue", session)):
        wclm.refuses(
            *command, "--out", "x", because=["has no session/session.json", "cannot be continued, refined or corrected"]
        )
    wclm.refuses("map", session, "--format", "g2o", because=["has no session/session.json"])
    assert wclm("map", session, "--format", "svg").exit_code == 0
    assert wclm("report", session, "--overwrite").exit_code == 0


@pytest.mark.parametrize("optimised", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_exported_graph_has_the_optimum_of_the_session(wclm: Any, session: Path, optimised: bool) -> None:
    if optimised:
        assert wclm("optimize", session, "--out", "better", "--no-review").exit_code == 0
        session = Path("better")
    result = wclm("map", session, "--format", "g2o")
    assert result.exit_code == 0, result.output
    vertices = [line.split() for line in (session / "map.g2o").read_text().splitlines() if line.startswith("VERTEX")]
    walls = sum(1_000_000 <= int(identity) < 2_000_000 for _, identity, *_ in vertices)
    assert f" keyframes, {walls} walls, " in result.output
    graph = read_pose_graph(session / "map.g2o").graph
    map_ = read_map(session / MAP)
    stored = read_session(session).slam_state.mapper
    converge(stored)  # joins merged walls
    assert graph.edge_count == stored.graph.factor_count - 1  # the prior of the first keyframe, which is fixed instead
    assert set(1_000_000 + map_.walls.identity) <= set(graph.pose_ids)
    assert set(2_000_000 + map_.corners.identity) == set(graph.landmark_ids)
    solved = optimise(graph)
    assert solved.chi2 > 0.98 * solved.chi2_before
    moved = se2.between(graph.poses, solved.graph.poses)
    keyframes = graph.pose_ids < 1_000_000
    assert np.abs(moved[keyframes, :2]).max() < 2e-3
    assert np.abs(moved[~keyframes, 1]).max() < 2e-3  # the position along a wall is not determined
    assert np.degrees(np.abs(moved[keyframes, 2])).max() < 0.05
    assert np.degrees(np.abs(moved[~keyframes, 2])).max() < 0.2  # the heading of short walls is uncertain
    assert np.abs(solved.graph.landmarks - graph.landmarks).max() < 2e-3

"""The commands that go on from a session: run --continue and --localize, optimize, map --format g2o."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from slam.io.recordings import open_recording

from drivers import se2
from drivers.recordings.mcap import McapWriter
from drivers.simulation import Simulation
from slam.graph.pose_graph import optimise, read_pose_graph
from slam.io.map_json import read_map
from slam.io.output_dir import MAP, RESULTS, SESSION, SUMMARY, TRAJECTORY
from slam.io.run_results import read_run_results
from slam.io.sessions import read_session
from slam.io.tum import read_tum

DRIVES = {"first": (1, 0.0, 20.0), "second": (2, 10.0, 22.0)}
"""Seed, begin and end of drives through the office, by the recordings' names."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of the drives, each with a clock of its own that begins at zero."""
    folder = tmp_path_factory.mktemp("recordings")
    for name, (seed, begin, end) in DRIVES.items():
        messages = list(Simulation("office", seed=seed, duration=end))
        with McapWriter(folder / f"{name}.mcap") as writer:
            for message in messages:
                if message.stamp - messages[0].stamp >= begin:
                    writer.write(message)
    return folder


@pytest.fixture
def session(wclm: Any, folder: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """What `wclm run` leaves of the first drive; made once."""
    made = folder / "out"
    if not made.exists():
        result = wclm("run", folder / "first.mcap", "--out", made, "--no-review")
        assert result.exit_code == 0, result.output
    return Path(shutil.copytree(made, tmp_path / "out"))


def test_a_run_is_gone_on_with(wclm: Any, folder: Path, session: Path) -> None:
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
    assert len(read_map(Path("both", MAP)).lines) > len(read_map(session / MAP).lines)
    chained = [message.stamp for message in open_recording(read_run_results(Path("both")))]
    assert chained == sorted(chained)
    assert wclm("map", "both", "--format", "ply").exit_code == 0
    assert wclm("run", folder / "second.mcap", "--continue", "both", "--out", "both", "--no-review").exit_code == 2
    again = wclm("run", folder / "first.mcap", "--continue", "both", "--out", "both", "--overwrite", "--no-review")
    assert again.exit_code == 0, again.output
    assert len(json.loads(Path("both", SUMMARY).read_text())["recordings"]) == 3


def test_a_run_is_localised(wclm: Any, folder: Path, session: Path) -> None:
    result = wclm("run", folder / "second.mcap", "--localize", session, "--out", "there", "--no-review")
    assert result.exit_code == 0, result.output
    assert SESSION not in {file.name for file in Path("there").iterdir()}
    before, after = read_map(session / MAP).lines, read_map(Path("there", MAP)).lines
    np.testing.assert_array_equal(after.identity, before.identity)
    np.testing.assert_allclose(after.frame, before.frame, atol=1e-5)
    assert wclm("map", "there", "--format", "ply").exit_code == 0
    wclm.refuses(
        "run", folder / "second.mcap", "--localize", "there", "--out", "x", because=["there: holds no session"]
    )
    wclm.refuses("run", "sim:room", "--localize", session, "--out", "x", because=["sim:room", "nowhere on the map"])
    assert not Path("x").exists()


def test_one_or_the_other(wclm: Any, session: Path) -> None:
    result = wclm("run", "sim:room", "--localize", session, "--continue", session, "--out", "x")
    assert result.exit_code == 2
    assert "either the map grows or it stays as it is" in result.stderr


def test_a_session_is_optimised(wclm: Any, session: Path) -> None:
    result = wclm("optimize", session, "--out", "better", "--plot")
    assert result.exit_code == 0, result.output
    for words in ("before", "after", "closures   0 added, 0 removed", "median, most of all"):
        assert words in result.stdout
    assert {file.name for file in Path("better").iterdir()} == RESULTS
    summary = json.loads(Path("better", SUMMARY).read_text())
    assert summary["slam"]["refinement"]["factors_after"] == summary["slam"]["factors"]
    np.testing.assert_array_equal(read_tum(Path("better", TRAJECTORY)).stamps, read_tum(session / TRAJECTORY).stamps)
    assert len(read_session(Path("better")).scans) == len(read_session(session).scans)
    wclm.refuses("optimize", session, "--out", "better", because=["better: exists already"])


def test_a_recording_is_mapped_and_optimised(wclm: Any) -> None:
    result = wclm("optimize", "sim:room?duration=5", "--out", "room", "--no-review")
    assert result.exit_code == 0, result.output
    assert wclm("run", "sim:room?duration=5", "--continue", "room", "--out", "more", "--no-review").exit_code == 0
    wclm.refuses("optimize", "nowhere.txt", "--out", "x", because=["nowhere.txt"])


def test_what_cannot_be_gone_on_from_is_refused(wclm: Any, session: Path) -> None:
    shutil.rmtree(session / SESSION)  # as an older version left it
    for command in (("optimize", session), ("run", "sim:room", "--continue", session)):
        wclm.refuses(*command, "--out", "x", because=["holds no session/session.json", "cannot be gone on from"])
    wclm.refuses("map", session, "--format", "g2o", because=["holds no session/session.json"])
    assert wclm("map", session, "--format", "svg").exit_code == 0
    assert wclm("report", session, "--overwrite").exit_code == 0


@pytest.mark.parametrize("optimised", [False, True])
def test_the_graph_has_its_optimum_where_the_session_has_it(wclm: Any, session: Path, optimised: bool) -> None:
    if optimised:
        assert wclm("optimize", session, "--out", "better", "--no-review").exit_code == 0
        session = Path("better")
    result = wclm("map", session, "--format", "g2o")
    assert result.exit_code == 0, result.output
    graph = read_pose_graph(session / "map.g2o").graph
    map_ = read_map(session / MAP)
    stored = read_session(session).slam_state.mapper
    stored.converge()  # walls that are one are tied
    assert graph.edge_count == stored.graph.factor_count - 1  # the first keyframe's prior; it is fixed instead
    assert set(1_000_000 + map_.lines.identity) <= set(graph.pose_ids)
    assert set(2_000_000 + map_.corners.identity) == set(graph.landmark_ids)
    solved = optimise(graph)
    assert solved.chi2 > 0.98 * solved.chi2_before
    moved = se2.between(graph.poses, solved.graph.poses)
    keyframes = graph.pose_ids < 1_000_000
    assert np.abs(moved[keyframes, :2]).max() < 2e-3
    assert np.abs(moved[~keyframes, 1]).max() < 2e-3  # along a wall its frame may stand anywhere
    assert np.degrees(np.abs(moved[keyframes, 2])).max() < 0.05
    assert np.degrees(np.abs(moved[~keyframes, 2])).max() < 0.2  # walls of decimetres are known to a degree
    assert np.abs(solved.graph.landmarks - graph.landmarks).max() < 2e-3

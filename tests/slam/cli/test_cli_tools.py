"""`wclm simulate`, `info`, `features` and `eval`."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drivers
from drivers import GroundTruth, Scan
from drivers.recordings.mcap import McapWriter
from drivers.simulation import Simulation
from slam.io.output_dir import TRAJECTORY

SHORT = "sim:room?duration=3&lidar=short"


def test_simulate_writes_a_recording_that_info_describes(wclm: Any, tmp_path: Path) -> None:
    result = wclm("simulate", "room", "a.mcap", "--duration", "3", "--seed", "2")
    assert result.exit_code == 0, result.output
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.mcap"]
    text = wclm("info", "a.mcap").stdout
    for words in (
        "29, 10 per second, from /scan",
        "76, 25 per second",
        " m driven, from /odom",
        "920 from -180.0 to 179.6 degrees",
        "at x 0.100 m",
    ):
        assert words in text
    wclm.refuses("simulate", "room", "a.mcap", "--duration", "3", because=["a.mcap: exists already"])
    assert wclm("simulate", "room", "a.mcap", "--duration", "3", "--overwrite").exit_code == 0


def test_invalid_simulations_are_refused(wclm: Any, tmp_path: Path) -> None:
    wclm.refuses("simulate", "moon", "a.mcap", because=["moon: no such world; choose one of "])
    wclm.refuses("simulate", "room", "a.mcap", "--duration", "-1", because=["duration must be positive"])
    assert wclm("simulate", "room", "a.bag").exit_code == 2
    assert not list(tmp_path.iterdir())


def test_info_reports_problems(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text(
        "".join(f"ODOM {0.1 * k} 0 0 0 0 0 {1e9 + k / 10} host {k / 10}\n" for k in range(50) if not 10 < k < 40)
    )
    text = wclm("info", "a.clf").stdout
    assert "2001-09-09 01:46:40 UTC" in text
    assert "warning     no scans" in text
    assert "1 gap in the odometry" in text


def test_sorted_messages_are_not_counted_as_skipped(wclm: Any, tmp_path: Path) -> None:
    stamps = [1e9 + k / 10 for k in range(50)]
    stamps[20], stamps[21] = stamps[21], stamps[20]
    lines = [f"ODOM {0.1 * k} 0 0 0 0 0 {stamp} host {stamp}\n" for k, stamp in enumerate(stamps)]
    (tmp_path / "a.clf").write_text("".join(lines))
    text = wclm("info", "a.clf").stdout
    assert "corrected   stamp less than a second out of order; sorted (1 time)" in text
    assert "skipped" not in text
    lines[30] = lines[30].replace("ODOM", "ODOM x")
    (tmp_path / "a.clf").write_text("".join(lines))
    assert "1 entry skipped, first a.clf:31: " in wclm("info", "a.clf").stdout


@pytest.mark.parametrize(
    ("weakest", "strongest", "text"),
    [
        (0.0, 4095.0, "0 to 4095, in the lidar's own unit"),
        (0.0, 7.3e31, "0 to 7.3e+31: memory that the driver did not set"),
        (0.0, 2.1e-35, "0 to 2.1e-35: memory that the driver did not set"),
        (47.0, 47.0, "47 for all returns: not measured"),
    ],
)
def test_intensities_that_a_driver_did_not_set_are_named(
    wclm: Any, tmp_path: Path, weakest: float, strongest: float, text: str
) -> None:
    with McapWriter(tmp_path / "a.mcap") as writer:
        for message in drivers.open(SHORT):
            if isinstance(message, Scan):
                message = replace(message, intensities=np.linspace(weakest, strongest, len(message.ranges)))
            writer.write(message)
    assert f"intensity   {text}" in wclm("info", "a.mcap").stdout


def test_run_names_the_gaps_that_info_names(wclm: Any, tmp_path: Path) -> None:
    with McapWriter(tmp_path / "a.mcap") as writer:
        for message in drivers.open("sim:room?duration=6&lidar=short"):
            if not (isinstance(message, Scan) and 2.0 < message.stamp < 4.0):
                writer.write(message)
    gap = re.compile(r"warning +1 gap in the scans, the longest 2\.\d s at 0:0[12]")
    result = wclm("run", "a.mcap", "--out", "out", "--no-review")
    for text in (wclm("info", "a.mcap").stdout, result.stdout):
        assert gap.search(text)
    (line,) = json.loads((tmp_path / "out" / "summary.json").read_text())["gaps"]
    assert line in (tmp_path / "out" / "report.html").read_text()


def test_features_prints_and_plots_one_scan(wclm: Any, tmp_path: Path) -> None:
    drive = "sim:room?duration=3"
    result = wclm("features", drive, "--scan", "7", "--plot", "scan.png")
    assert result.exit_code == 0, result.output
    assert "sim:room, scan 7 at 0.713 s" in result.stdout
    assert re.search(r"^ +0 +\d+ +\d+\.\d{3} ", result.stdout, re.MULTILINE)
    assert (tmp_path / "scan.png").stat().st_size > 10_000
    wclm.refuses("features", drive, "--scan", "29", because=["has 29 scans, from 0; there is no scan 29"])
    assert wclm("features", drive, "--scan", "-1").exit_code == 2


@pytest.fixture
def scored(tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text("".join(f"{k} {k} {0.01 * (k % 2)} 0 0 0 0 1\n" for k in range(20)))
    (tmp_path / "truth.tum").write_text("".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(20)))
    (tmp_path / "a.relations").write_text("".join(f"{k} {k + 3} 3 0 0 0 0 0\n" for k in range(15)))


@pytest.mark.parametrize("picture", ["scan.pdf", "nowhere/scan.png"])
def test_pictures_that_cannot_be_written_are_refused_at_once(wclm: Any, picture: str) -> None:
    for command in (("features", "missing.clf", "--scan", "0"), ("eval", "missing", "--reference", "missing.tum")):
        wclm.refuses(*command, "--plot", picture, because=[f"'--plot': {picture}: the"])


@pytest.mark.usefixtures("scored")
def test_eval_scores_relations(wclm: Any, tmp_path: Path) -> None:
    score = ("eval", "a.tum", "--relations", "a.relations")
    result = wclm(*score, "--json", "--plot", "a.png")
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert (figures["relations"], figures["trans_mean"], figures["missing"]) == (15, 0.01, 0)
    assert (tmp_path / "a.png").exists()
    assert "translation 0.0100 +- 0.0000 m" in wclm(*score).stdout


@pytest.mark.usefixtures("scored")
def test_eval_has_exit_status_1_for_relations_outside_the_trajectory(wclm: Any, tmp_path: Path) -> None:
    with (tmp_path / "a.relations").open("a") as file:
        file.write("18 25 7 0 0 0 0 0\n")
    result = wclm("eval", "a.tum", "--relations", "a.relations", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["missing"] == 1
    assert "1 relations lie outside" in result.stderr


@pytest.mark.usefixtures("scored")
def test_eval_scores_against_a_reference(wclm: Any, tmp_path: Path) -> None:
    result = wclm("eval", "a.tum", "--reference", "truth.tum", "--json", "--plot", "a.png")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["ate_rmse"] == pytest.approx(0.005, rel=0.01)
    assert (tmp_path / "a.png").exists()
    assert "20 at common times" in wclm("eval", "a.tum", "--reference", "truth.tum").stdout


def test_a_simulated_drive_is_scored_by_its_own_truth(wclm: Any, tmp_path: Path) -> None:
    """That is in the recording, and in a file if one is named."""
    simulated = wclm("simulate", "room", "a.mcap", "--duration", "5", "--truth", "truth.tum")
    assert simulated.exit_code == 0, simulated.output
    assert wclm("run", "a.mcap", "--out", "map", "--no-review").exit_code == 0
    own, of_file = (wclm("eval", "map", *more, "--json") for more in ((), ("--reference", "truth.tum")))
    assert own.exit_code == 0, own.output
    figures = json.loads(own.stdout)
    assert figures["ate_rmse"] < 0.02
    assert figures == pytest.approx(json.loads(of_file.stdout), abs=1e-5)
    recorded = json.loads((tmp_path / "map" / "summary.json").read_text())["truth"]
    assert figures["ate_rmse"] == pytest.approx(recorded["ate_rmse"], abs=1e-5)
    assert wclm("run", "a.mcap", "--continue", "map", "--out", "longer", "--no-review").exit_code == 0
    assert json.loads(wclm("eval", "longer", "--json").stdout)["ate_rmse"] < 0.05
    wclm.refuses("eval", "truth.tum", because=["one of the two is required, unless"])
    wclm.refuses("simulate", "room", "b.mcap", "--truth", "truth.tum", because=["truth.tum: exists already"])
    assert not (tmp_path / "b.mcap").exists()


def test_eval_needs_a_reference_for_a_recording_without_truth(wclm: Any, tmp_path: Path) -> None:
    with McapWriter(tmp_path / "a.mcap") as writer:
        for message in Simulation("room", duration=2.0):
            if not isinstance(message, GroundTruth):
                writer.write(message)
    assert wclm("run", "a.mcap", "--out", "map", "--no-review").exit_code == 0
    wclm.refuses("eval", "map", because=["map: a.mcap has no ground truth; name --reference or --relations"])


@pytest.mark.usefixtures("scored")
def test_eval_warns_if_the_trajectory_is_of_another_drive(wclm: Any, tmp_path: Path) -> None:
    turning = "".join(f"{k} {k % 2} {k % 3} 0 0 0 {k % 2} {1 - k % 2}\n" for k in range(20))
    (tmp_path / "other.tum").write_text(turning)
    for truth in (("--reference", "truth.tum"), ("--relations", "a.relations")):
        result = wclm("eval", "other.tum", *truth)
        assert result.exit_code == 0
        assert f"other.tum: its turns are not those of {truth[1]}: are both of the same drive?" in result.stderr
        assert not wclm("eval", "a.tum", *truth).stderr


@pytest.mark.usefixtures("scored")
def test_eval_takes_the_output_directory_of_a_run(wclm: Any, tmp_path: Path) -> None:
    """It has the trajectory in a file whose name is always the same."""
    (tmp_path / "out").mkdir()
    (tmp_path / "a.tum").rename(tmp_path / "out" / TRAJECTORY)
    assert "translation 0.0100 +- 0.0000 m" in wclm("eval", "out", "--relations", "a.relations").stdout
    for both in (("out", "--reference", "truth.tum"), ("truth.tum", "--reference", "out")):
        assert "0.0050 m RMSE after alignment" in wclm("eval", *both).stdout
    wclm.refuses("eval", ".", "--relations", "a.relations", because=[f"{TRAJECTORY}: No such file"])


@pytest.mark.usefixtures("scored")
def test_invalid_files_for_eval_are_one_line_errors(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "bad.tum").write_text("1 2 3\n")
    (tmp_path / "empty.tum").write_text("")
    wclm.refuses("eval", "bad.tum", "--reference", "truth.tum", because=["bad.tum:1: expected 8 numbers"])
    wclm.refuses("eval", "empty.tum", "--relations", "a.relations", because=["empty.tum: has no line"])
    wclm.refuses("eval", "none.tum", "--relations", "a.relations", because=["none.tum: No such file"])
    wclm.refuses("eval", "a.tum", "--relations", "bad.tum", because=["bad.tum:1: expected 8 numbers (t1 t2"])
    assert wclm("eval", "a.tum").exit_code == 2
    assert wclm("eval", "a.tum", "--reference", "truth.tum", "--relations", "a.relations").exit_code == 2


@pytest.mark.parametrize("information", ["1e308", "1e200"])
def test_a_pose_graph_without_a_finite_optimum_is_refused(wclm: Any, tmp_path: Path, information: str) -> None:
    row = f"{information} 0 0 {information} 0 {information}"
    (tmp_path / "a.g2o").write_text(f"VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1e200 0 0 {row}\n")
    wclm.refuses("optimize", "a.g2o", "--out", "out", because=["a.g2o: its numbers are so large"])
    assert not (tmp_path / "out").exists()

"""`wclm`: help, `run` and `demo`, and the files that remain after a failure."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.recordings.mcap import McapWriter
from drivers.simulation import LidarModel, Simulation
from drivers.timing.beam_times import BeamTimes
from drivers.timing.mount_heading import MountHeading
from slam.cli import viewer
from slam.errors import MapError
from slam.io.output_dir import CLOSURE_PICTURE, PICTURE, RESULTS, SESSION
from slam.io.recording_timing import RecordingTiming
from slam.io.tum import read_tum
from slam.offline.calibration.extrinsics import Calibration, OdometryCorrection

COMMANDS = (
    "demo",
    "run",
    "batch",
    "map",
    "report",
    "review",
    "optimize",
    "merge",
    "info",
    "simulate",
    "emulate",
    "devices",
    "record",
    "replay",
    "eval",
    "features",
    "bench",
    "bench features",
    "bench slam",
    "bench gate",
    "bench relocalisation",
    "bench residuals",
    "bench robust",
    "bench laps",
    "bench consistency",
    "bench paper",
    "bench lookalike",
    "bench false-closures",
)
SHORT = "sim:room?duration=3&lidar=short"
ESCAPES = re.compile(r"\x1b\[[0-9;]*m")

# Help and version


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_usage_and_example(wclm: Any, command: str) -> None:
    result = wclm(*command.split(), "--help")
    text = ESCAPES.sub("", result.stdout)
    assert result.exit_code == 0
    assert "Usage: " in text
    assert command == "bench" or f"Example: wclm {command}" in text


def test_help_shows_brackets_that_are_no_markup(wclm: Any) -> None:
    assert "pip install 'wclm-slam[ros2]'" in " ".join(ESCAPES.sub("", wclm("ros", "--help").stdout).split())


def test_version_prints_all_versions(wclm: Any) -> None:
    result = wclm("--version")
    assert result.exit_code == 0
    assert re.match(r"wclm-slam \d+\.\d+\.\d+, numpy ", result.stdout)


def test_help_imports_no_heavy_package() -> None:
    code = (
        "import sys; sys.argv = ['wclm', '--help']\nimport slam.cli\n"
        "try: slam.cli.main()\nexcept SystemExit: pass\n"
        "heavy = {'gtsam', 'rerun', 'numba', 'matplotlib', 'rosbags', 'mcap', 'distributed', 'pyarrow'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=250)
    assert "Usage: wclm" in answer.stdout
    assert "Mapping" in answer.stdout
    assert answer.stderr.strip() == "[]"


def test_wrong_usage_has_exit_status_2(wclm: Any) -> None:
    for arguments in (["nothing"], ["run"], ["run", "a.clf"], ["run", "a.clf", "--out", "o", "--fast"]):
        result = wclm(*arguments)
        assert result.exit_code == 2
        assert "Traceback" not in result.output


# run


def test_run_writes_all_results_and_prints_the_directory(wclm: Any, fake_slam: type, tmp_path: Path) -> None:
    result = wclm("run", SHORT, "--out", "a/out", "--no-review", "--plot", "--set", "lidar.sigma_range=0.02")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    out = tmp_path / "a" / "out"
    assert {file.name for file in out.iterdir()} == RESULTS - {"review.rrd"}
    assert len(read_tum(out / "trajectory.tum")) == 76
    assert "sigma_range = 0.02" in (out / "config.toml").read_text()
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["scans"], summary["odometry"], summary["walls"]) == (16, 76, 4)
    assert summary["slam"] == {"closures": 0}
    assert summary["truth"]["ate_rmse"] < 0.1
    assert summary["versions"]["wclm-slam"]
    assert summary["peak_memory_mib"] > 1
    text = result.stdout
    for words in (
        "sim:room: 16 scans in 3.0 s",
        "4 walls, 2 corners",
        "error of the path",
        "a/out: config.toml, keyframes.csv, map",
    ):
        assert words in text
    assert "rerun" not in text


def test_a_part_of_the_results_that_cannot_be_written_costs_no_other(
    wclm: Any, fake_slam: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ValueError("an odd value")

    monkeypatch.setattr("slam.io.sessions.session.write_factors", fail)
    monkeypatch.setattr("slam.visualisation.plots.plot_map", fail)
    result = wclm("run", SHORT, "--out", "out", "--no-review", "--plot")
    assert result.exit_code == 0, result.output
    assert {file.name for file in (tmp_path / "out").iterdir()} == RESULTS - {"review.rrd", PICTURE, SESSION}
    warnings = [
        "the session is not written, so the map cannot be continued, refined or corrected: ValueError: an odd value",
        "the picture of the map is not written: ValueError: an odd value",
    ]
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"] == warnings
    for warning in warnings:
        assert re.search(rf"warning +{re.escape(warning)}$", result.stdout, re.MULTILINE)


def test_a_recording_whose_name_is_not_utf_8_is_mapped(wclm: Any, fake_slam: type, tmp_path: Path) -> None:
    name = os.fsdecode(b"b\xfcro.mcap")
    with McapWriter(tmp_path / name) as writer:
        for message in Simulation("room", seed=0, duration=3.0):
            writer.write(message)
    assert "b\ufffdro.mcap" in wclm("info", name).stdout
    result = wclm("run", name, "--out", "out", "--plot")
    assert result.exit_code == 0, result.output
    assert {file.name for file in (tmp_path / "out").iterdir()} == RESULTS


def test_info_and_run_state_how_a_recording_is_read(wclm: Any, fake_slam: type, tmp_path: Path) -> None:
    """The log has stamps in milliseconds, and its odometry stands still while the scans change."""
    lines = []
    for k in range(200):
        x, r = 1.0 + 0.05 * min(k, 100), 2.0 + 0.1 * (k % 50)
        lines.append(f"FLASER 3 {r} {r} {r} {x} 0 0 {x} 0 0 {100 * k} host 0\n")
    (tmp_path / "log.clf").write_text("".join(lines))
    result = wclm("run", "log.clf", "--out", "out", "--no-review")
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    (read_as,), (doubt,) = summary["interpretations"], summary["doubts"]
    assert read_as == "stamps in milliseconds, converted to seconds"
    assert doubt.startswith("odometry stands still while the scans change (once, the longest 9.9 s at 0:10)")
    for output in (result.stdout, wclm("info", "log.clf").stdout):
        assert re.search(rf"read as +{re.escape(read_as)}$", output, re.MULTILINE)
        assert re.search(rf"warning +{re.escape(doubt)}$", output, re.MULTILINE)


def test_mapping_a_simulated_room_is_accurate_and_repeatable(wclm: Any, tmp_path: Path) -> None:
    for name in ("a", "b"):
        result = wclm("run", "sim:room?duration=8&lidar=short", "--out", name, "--no-review")
        assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert summary["truth"]["ate_rmse"] < 0.01
    assert summary["walls"] >= 4
    assert 0 < summary["slam_seconds"] < summary["wall_seconds"]
    for file in ("trajectory.tum", "map.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


@pytest.mark.parametrize("options", [[], ["--refine"]])
def test_refine_option_is_passed_to_the_pipeline(wclm: Any, fake_slam: Any, options: list[str]) -> None:
    assert wclm("run", "sim:room", "--out", "out", "--no-review", *options).exit_code == 0
    assert fake_slam.refined == bool(options)


def test_review_log_is_written_and_its_command_is_printed(wclm: Any, fake_slam: type, tmp_path: Path) -> None:
    result = wclm("run", SHORT, "--out", "out")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "review.rrd").stat().st_size > 0
    assert "wclm review out" in result.stdout


def test_number_of_printed_warnings_is_limited(wclm: Any, fake_slam: Any) -> None:
    fake_slam.notices = 10
    result = wclm("run", SHORT, "--out", "out", "--no-review")
    assert "notice number 3 (at 0:03)" in result.stdout
    assert "notice number 4" not in result.stdout
    assert "6 more warnings" in result.stdout


def test_existing_results_are_refused_before_reading_and_replaced_with_overwrite(wclm: Any, fake_slam: Any) -> None:
    assert wclm("run", SHORT, "--out", "out", "--no-review").exit_code == 0
    fake_slam.fails = AssertionError("mapping started")
    wclm.refuses("run", SHORT, "--out", "out", because=["out: exists already", "--overwrite"])
    wclm.refuses("run", "absent.clf", "--out", "out", because=["out: exists already"])
    fake_slam.fails = None
    assert wclm("run", SHORT, "--out", "out", "--no-review", "--overwrite").exit_code == 0


@pytest.mark.parametrize("review", ["--review", "--no-review"])
def test_a_failed_run_leaves_no_files(wclm: Any, fake_slam: Any, tmp_path: Path, review: str) -> None:
    fake_slam.fails = MapError("the map is lost")
    wclm.refuses("run", SHORT, "--out", "out", review, because=["wclm: sim:room: the map is lost"])
    assert not list(tmp_path.iterdir())


def test_ctrl_c_prints_one_line_and_leaves_no_files(wclm: Any, fake_slam: Any, tmp_path: Path) -> None:
    fake_slam.fails = KeyboardInterrupt()
    result = wclm("run", SHORT, "--out", "out")
    assert result.exit_code == 130
    assert result.stderr == "wclm: interrupted; nothing was written\n"
    assert not list(tmp_path.iterdir())


def test_an_unexpected_exception_is_raised(wclm: Any, fake_slam: Any, tmp_path: Path) -> None:
    fake_slam.fails = ZeroDivisionError("a bug")
    result = wclm("run", SHORT, "--out", "out")
    assert isinstance(result.exception, ZeroDivisionError)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["run {} --out out", "info {}", "features {} --scan 0"])
@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("missing.clf", None, "missing.clf: no such file"),
        ("empty.clf", b"", "empty.clf: "),
        ("empty.mcap", b"", "empty.mcap: "),
        ("empty.bag", b"", "empty.bag: "),
        ("garbage.clf", bytes(range(256)) * 8, "garbage.clf: "),
        ("garbage.mcap", bytes(range(256)) * 8, "garbage.mcap: "),
        ("photo.jpg", b"x", "photo.jpg: the extension .jpg is not supported"),
        ("noextension", b"x", "noextension: a file without extension is not supported"),
    ],
)
def test_invalid_recordings_are_one_line_errors(
    wclm: Any, fake_slam: type, tmp_path: Path, command: str, name: str, content: bytes | None, words: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    before = sorted(tmp_path.iterdir())
    wclm.refuses(*command.format(name).split(), because=[words])
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("eval", "Missing argument 'TRAJECTORY'"),
        ("eval a.tum", "one of the two is required, unless"),
        ("bench nothing", "No such command 'nothing'"),
        ("run a.clf --bogus", "No such option: --bogus"),
        ("run a.clf --out", "Option '--out' requires an argument"),
    ],
)
def test_wrong_arguments_are_one_line_errors_that_name_the_help(wclm: Any, command: str, words: str) -> None:
    name = command.split()[0]
    wclm.refuses(*command.split(), because=[words, f"{name} --help"])


def test_a_run_that_is_to_be_scored_must_exist(wclm: Any) -> None:
    wclm.refuses("eval", "nowhere", because=["nowhere: no such directory; expected the output directory of `wclm run`"])


def test_a_wrong_option_without_a_command_is_a_one_line_error(wclm: Any) -> None:
    wclm.refuses("--bogus", because=["No such option: --bogus; see ", " --help"])


@pytest.mark.parametrize("option", ["--datasets", "--versions"])
def test_benchmarks_do_not_run_without_the_directory_that_is_named(wclm: Any, option: str) -> None:
    wclm.refuses("bench", "slam", option, "nowhere", because=[option, "dir 'nowhere' does not exist"])


@pytest.mark.parametrize("command", ["run", "info", "map", "measure", "review", "simulate", "eval", "batch", "merge"])
def test_usage_has_the_words_for_arguments_that_the_help_uses(wclm: Any, command: str) -> None:
    usage = re.sub(r"\s+", " ", wclm(command, "--help").stdout)
    arguments = re.search(r"\[OPTIONS\] (\S+)", usage)
    assert arguments is not None
    assert arguments[1].rstrip(".") in ("{RECORDING}", "{SESSION}", "{WORLD}", "{TRAJECTORY}")


@pytest.mark.skipif(os.geteuid() == 0, reason="root can read every file")
def test_an_unreadable_recording_is_a_one_line_error(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text("x")
    (tmp_path / "a.clf").chmod(0)
    wclm.refuses("run", "a.clf", "--out", "out", because=["a.clf: cannot be read: Permission denied"])


def test_an_empty_directory_is_refused_as_recording(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    wclm.refuses("run", "bag", "--out", "out", because=["bag: the directory is not a ROS 2 bag"])


@pytest.mark.parametrize("command", ["run", "info", "calibrate", "replay", "features"])
def test_results_are_refused_as_recording_before_options_are_missed(wclm: Any, tmp_path: Path, command: str) -> None:
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "map.json").write_text("{}")
    hints = ("wclm review map", "--continue map", "wclm optimize map")
    wclm.refuses(command, "map", because=["map: contains the results of a run and no recording", *hints])


def test_refinement_is_refused_if_the_map_is_not_extended(wclm: Any) -> None:
    refused = ("run", "a.clf", "--localize", "map", "--refine", "--out", "out")
    wclm.refuses(*refused, because=["--refine: is for runs that extend a map, not for --localize"])


def test_a_directory_without_permission_is_refused(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(_: Path) -> bool:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "is_file", denied)
    wclm.refuses("info", "locked", because=["locked: cannot be read: Permission denied"])


def test_recordings_in_a_directory_are_named(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "drives").mkdir()
    for number in range(7):
        (tmp_path / "drives" / f"{number}.bag").touch()
    (tmp_path / "drives" / "README.txt").touch()
    named = "name one of the recordings in it: 0.bag, 1.bag, 2.bag, 3.bag, 4.bag and 2 more"
    wclm.refuses("run", "drives", "--out", "out", because=["drives: the directory is not a ROS 2 bag", named])


def test_invalid_settings_are_one_line_errors(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("[lidar]\nsigma_rang = 1\n")
    run = ("run", SHORT, "--out", "out")
    wclm.refuses(*run, "--config", "a.toml", because=["a.toml: lidar.sigma_rang: no such setting"])
    wclm.refuses(*run, "--config", "b.toml", because=["b.toml: No such file"])
    wclm.refuses(*run, "--set", "lidar.sigma_range=wide", because=["--set lidar.sigma_range=wide: ", "valid number"])
    wclm.refuses(*run, "--set", "sigma", because=["--set sigma: must have the form group.key=value"])
    assert not (tmp_path / "out").exists()


def test_a_file_as_output_directory_is_a_one_line_error(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("x")
    wclm.refuses("run", SHORT, "--out", "out", "--overwrite", because=["out: is a file"])


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM])
def test_an_interrupted_process_leaves_no_files(tmp_path: Path, number: signal.Signals) -> None:
    # In the background of a shell SIGINT is ignored, which child processes inherit.
    program = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from slam.cli import main; main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, "run", "sim:office", "--out", "out"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 200  # includes compilation
    while not list(tmp_path.glob(".out-*/review.rrd")) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(number)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 128 + number
    assert "Traceback" not in errors
    assert not list(tmp_path.iterdir())


# demo


def test_demo_runs_without_a_display(wclm: Any, fake_slam: type, tmp_path: Path, short_demo: None) -> None:
    result = wclm("demo", "--seed", "5")
    assert result.exit_code == 0, result.output
    assert {file.name for file in (tmp_path / "demo").iterdir()} == RESULTS
    assert json.loads((tmp_path / "demo" / "summary.json").read_text())["seed"] == 5
    assert "ATE RMSE" in result.stdout
    wclm.refuses("demo", because=["demo: exists already"])


@pytest.mark.slow
def test_demo_opens_the_viewer_if_there_is_a_display(
    wclm: Any, fake_slam: type, short_demo: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[list[str]] = []
    monkeypatch.setattr(viewer, "open_viewer", opened.append)
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert wclm("demo", "--no-view").exit_code == 0
    assert not opened
    Path("demo", CLOSURE_PICTURE).touch()  # written if the loop is closed
    assert wclm("demo", "--overwrite").exit_code == 0
    assert opened == [viewer.viewer_command(Path("demo"))]


@pytest.fixture
def short_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    from drivers import simulation

    whole = simulation.Simulation
    monkeypatch.setattr(simulation, "Simulation", lambda world, **how: whole(world, **how, duration=3.0))


def test_a_viewer_that_cannot_be_started_is_a_one_line_message(capsys: pytest.CaptureFixture[str]) -> None:
    viewer.open_viewer(["/nowhere/rerun"])
    assert capsys.readouterr().err.startswith("wclm: the viewer cannot be started: ")


def test_calibrate_names_the_recording_that_it_cannot_use(wclm: Any) -> None:
    recording = "sim:room?duration=0.5"
    wclm.refuses("calibrate", recording, because=[f"{recording}: ", "too few to calibrate from"])


@pytest.mark.parametrize("option", ["--wheel-radius", "--track"])
@pytest.mark.parametrize("size", ["0", "inf", "nan"])
def test_calibrate_refuses_wheels_without_a_size(wclm: Any, option: str, size: str) -> None:
    wclm.refuses("calibrate", "drive.mcap", option, size, because=[option, "Input should be"])


@pytest.mark.parametrize("option", ["--wheel-radius", "--track"])
def test_calibrate_needs_both_dimensions_of_the_wheels(wclm: Any, option: str) -> None:
    wclm.refuses("calibrate", "drive.mcap", option, "0.1", because=[option, "both or none are required"])


def test_calibrate_prints_what_a_live_run_cannot_find(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    result = Calibration(np.array([0.1, 0.0, 3.0]), OdometryCorrection(), np.full(6, 0.01), 9, 9.0, (0.0, 0.01))
    timing = RecordingTiming(BeamTimes(reversed=True), used_delay=0.1, mount_heading=MountHeading(None, 3.0, 0.01, 20))
    monkeypatch.setattr("slam.offline.calibration.extrinsics.calibrate", lambda messages, config: result)
    monkeypatch.setattr(RecordingTiming, "of", lambda *_: timing)
    printed = wclm("calibrate", "sim:room?duration=1")
    live = "--lidar 'TYPE:PORT?mount=0.1000,0.0000,3.0000' --set lidar.beam_order=reversed --set lidar.delay=0.1000"
    assert f"\nwclm live: {live}\n" in printed.stdout


@pytest.mark.slow
def test_calibrate_states_why_a_delay_is_not_compensated(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    result = Calibration(np.array([0.1, 0.0, -1e-9]), OdometryCorrection(), np.full(6, 0.01), 9, 9.0, (-1e-9, 0.01))
    monkeypatch.setattr("slam.offline.calibration.extrinsics.calibrate", lambda messages, config: result)
    with McapWriter(Path("drive.mcap")) as writer:
        for message in Simulation("office", duration=25.0, lidar=LidarModel(beams=360, rate=5.0)):
            writer.write(message)
    printed = wclm("calibrate", "drive.mcap")
    assert printed.exit_code == 0, printed.output
    assert "s of the lidar against odometry; not compensated: not significant" in printed.stdout
    assert "lidar.delay" not in printed.stdout
    settings = "--set 'lidar.mount=[0.1000,0.0000,0.0000]' --set lidar.range_bias=0.0000"  # zeros have no sign
    assert f"\nwclm run: {settings}\n" in printed.stdout

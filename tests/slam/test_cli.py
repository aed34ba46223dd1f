import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from drivers.messages import Message, Odometry, Scan
from slam.cli import app, viewer
from slam.config import Config
from slam.errors import MapError
from slam.events import Finished, Noticed
from slam.outputs import RESULTS
from slam.trajectory import read_tum

COMMANDS = ("demo", "run", "info", "simulate", "eval", "features", "bench", "bench features")
SHORT = "sim:room?duration=3"
ESCAPES = re.compile(r"\x1b\[[0-9;]*m")

Wclm = Callable[..., Result]


@pytest.fixture
def wclm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Wclm:
    """Runs a command in an empty directory, in this process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return lambda *arguments: CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def fake_slam(monkeypatch: pytest.MonkeyPatch, finished: Finished) -> type:
    """A pipeline that believes odometry and finds a known room, so that failures can be had at will."""

    class FakeSlam:
        fails: BaseException | None = None
        notices = 0

        def __init__(self, config: Config, sinks: Sequence[Any]) -> None:
            self.sinks = sinks
            self.odometry: list[Odometry] = []

        def add(self, message: Message) -> None:
            if isinstance(message, Odometry):
                self.odometry.append(message)
            elif isinstance(message, Scan) and self.fails is not None:
                raise self.fails

        def finish(self) -> Finished:
            for k in range(self.notices):
                for sink in self.sinks:
                    sink.handle(Noticed(float(k), f"oddity number {k}"))
            return replace(
                finished,
                stamps=np.array([o.stamp for o in self.odometry]),
                poses=np.array([o.pose for o in self.odometry]),
            )

    monkeypatch.setattr("slam.pipeline.Slam", FakeSlam)
    return FakeSlam


def assert_mistake(result: Result, *words: str) -> None:
    """One line on stderr with these words, exit status 2, nothing on stdout."""
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    assert len(result.stderr.splitlines()) == 1, result.stderr
    assert result.stderr.startswith("wclm: ")
    assert result.stdout == ""
    for word in words:
        assert word in result.stderr


# Help and version


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(wclm: Wclm, command: str) -> None:
    result = wclm(*command.split(), "--help")
    text = ESCAPES.sub("", result.stdout)
    assert result.exit_code == 0
    assert "Usage: " in text
    assert command == "bench" or f"Example: wclm {command}" in text


def test_version(wclm: Wclm) -> None:
    result = wclm("--version")
    assert result.exit_code == 0
    assert re.match(r"wclm-slam \d+\.\d+\.\d+, numpy ", result.stdout)


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['wclm', '--help']\nimport slam.cli\n"
        "try: slam.cli.main()\nexcept SystemExit: pass\n"
        "heavy = {'gtsam', 'rerun', 'numba', 'matplotlib', 'rosbags', 'mcap'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "Commands" in answer.stdout
    assert answer.stderr.strip() == "[]"


def test_wrong_usage_has_exit_status_2(wclm: Wclm) -> None:
    for arguments in (["nothing"], ["run"], ["run", "a.clf"], ["run", "a.clf", "--out", "o", "--fast"]):
        result = wclm(*arguments)
        assert result.exit_code == 2
        assert "Traceback" not in result.output


# run


def test_run_writes_everything_and_says_where(wclm: Wclm, fake_slam: type, tmp_path: Path) -> None:
    result = wclm("run", SHORT, "--out", "a/out", "--no-review", "--plot", "--set", "lidar.sigma_range=0.02")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    out = tmp_path / "a" / "out"
    assert {file.name for file in out.iterdir()} == RESULTS - {"review.rrd"}
    assert len(read_tum(out / "trajectory.tum")) == 76
    assert "sigma_range = 0.02" in (out / "config.toml").read_text()
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["scans"], summary["odometry"], summary["walls"]) == (29, 76, 4)
    assert summary["slam"] == {"closures": 0}
    assert summary["truth"]["ate_rmse"] < 0.1
    assert summary["versions"]["wclm-slam"]
    assert summary["peak_memory_mib"] > 1
    text = result.stdout
    for words in ("sim:room: 29 scans in 3.0 s", "4 walls, 2 corners", "from the true path", "a/out: config.toml, map"):
        assert words in text
    assert "rerun" not in text


def test_the_log_is_written_and_how_to_open_it_is_said(wclm: Wclm, fake_slam: type, tmp_path: Path) -> None:
    result = wclm("run", SHORT, "--out", "out")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "review.rrd").stat().st_size > 0
    assert "rerun out/review.rrd" in result.stdout


def test_warnings_are_shown_but_not_without_end(wclm: Wclm, fake_slam: Any) -> None:
    fake_slam.notices = 10
    result = wclm("run", SHORT, "--out", "out", "--no-review")
    assert "oddity number 3 (at 3.00 s)" in result.stdout
    assert "oddity number 4" not in result.stdout
    assert "6 more warnings" in result.stdout


def test_two_runs_are_equal_byte_for_byte(wclm: Wclm, fake_slam: type, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert wclm("run", SHORT, "--out", name, "--no-review").exit_code == 0
    for file in ("trajectory.tum", "map.json", "config.toml"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_existing_results_are_refused_before_the_work_and_replaced_when_asked_for(wclm: Wclm, fake_slam: Any) -> None:
    assert wclm("run", SHORT, "--out", "out", "--no-review").exit_code == 0
    fake_slam.fails = AssertionError("the work began")
    assert_mistake(wclm("run", SHORT, "--out", "out"), "out: exists already", "--overwrite")
    fake_slam.fails = None
    assert wclm("run", SHORT, "--out", "out", "--no-review", "--overwrite").exit_code == 0


@pytest.mark.parametrize("review", ["--review", "--no-review"])
def test_nothing_is_left_of_a_run_that_fails(wclm: Wclm, fake_slam: Any, tmp_path: Path, review: str) -> None:
    fake_slam.fails = MapError("the map is lost")
    assert_mistake(wclm("run", SHORT, "--out", "out", review), "wclm: the map is lost")
    assert not list(tmp_path.iterdir())


def test_after_ctrl_c_there_is_one_line_and_nothing_else(wclm: Wclm, fake_slam: Any, tmp_path: Path) -> None:
    fake_slam.fails = KeyboardInterrupt()
    result = wclm("run", SHORT, "--out", "out")
    assert result.exit_code == 130
    assert result.stderr == "wclm: interrupted; nothing was written\n"
    assert not list(tmp_path.iterdir())


def test_a_bug_shows_itself(wclm: Wclm, fake_slam: Any, tmp_path: Path) -> None:
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
        ("photo.jpg", b"x", "photo.jpg: nothing reads the extension .jpg"),
        ("noextension", b"x", "noextension: nothing reads a file without an extension"),
    ],
)
def test_bad_recordings_are_one_line(
    wclm: Wclm, fake_slam: type, tmp_path: Path, command: str, name: str, content: bytes | None, words: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    before = sorted(tmp_path.iterdir())
    assert_mistake(wclm(*command.format(name).split()), words)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_an_unreadable_recording_is_one_line(wclm: Wclm, tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text("x")
    (tmp_path / "a.clf").chmod(0)
    assert_mistake(wclm("run", "a.clf", "--out", "out"), "a.clf: cannot be read: Permission denied")


def test_an_empty_directory_is_no_recording(wclm: Wclm, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    assert_mistake(wclm("run", "bag", "--out", "out"), "bag: the directory is not a ROS 2 bag")


def test_wrong_settings_are_one_line(wclm: Wclm, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("[lidar]\nsigma_rang = 1\n")
    run = ("run", SHORT, "--out", "out")
    assert_mistake(wclm(*run, "--config", "a.toml"), "a.toml: lidar.sigma_rang: there is no such setting")
    assert_mistake(wclm(*run, "--config", "b.toml"), "b.toml: No such file")
    assert_mistake(wclm(*run, "--set", "lidar.sigma_range=wide"), "--set lidar.sigma_range=wide: ", "valid number")
    assert_mistake(wclm(*run, "--set", "sigma"), "--set sigma: write it as group.key=value")
    assert not (tmp_path / "out").exists()


def test_an_output_in_the_way_is_one_line(wclm: Wclm, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("x")
    assert_mistake(wclm("run", SHORT, "--out", "out", "--overwrite"), "out: is a file")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_process_told_to_stop_leaves_nothing(tmp_path: Path, number: signal.Signals) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", "from slam.cli import main; main()", "run", "sim:office", "--out", "out"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob(".out-*/review.rrd")) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert "Traceback" not in errors
    assert not list(tmp_path.iterdir())


# demo


def test_the_demo_works_without_a_display(wclm: Wclm, fake_slam: type, tmp_path: Path, short_demo: None) -> None:
    result = wclm("demo", "--seed", "5")
    assert result.exit_code == 0, result.output
    assert {file.name for file in (tmp_path / "demo").iterdir()} == RESULTS
    assert json.loads((tmp_path / "demo" / "summary.json").read_text())["seed"] == 5
    assert "ATE RMSE" in result.stdout
    assert_mistake(wclm("demo"), "demo: exists already")


def test_the_demo_opens_the_viewer_where_there_is_a_display(
    wclm: Wclm, fake_slam: type, short_demo: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[list[str]] = []
    monkeypatch.setattr(viewer, "open_viewer", opened.append)
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert wclm("demo", "--no-view").exit_code == 0
    assert not opened
    assert wclm("demo", "--overwrite").exit_code == 0
    assert opened == [viewer.viewer_command(Path("demo"))]


@pytest.fixture
def short_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    from drivers import simulator

    whole = simulator.Simulation
    monkeypatch.setattr(simulator, "Simulation", lambda world, seed: whole(world, seed=seed, duration=3.0))


def test_a_viewer_that_cannot_be_started_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    viewer.open_viewer(["/nowhere/rerun"])
    assert capsys.readouterr().err.startswith("wclm: the viewer cannot be started: ")


# simulate, info, features


def test_a_simulation_is_recorded_and_looked_into(wclm: Wclm, tmp_path: Path) -> None:
    result = wclm("simulate", "room", "a.mcap", "--duration", "3", "--seed", "2")
    assert result.exit_code == 0, result.output
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.mcap"]
    text = wclm("info", "a.mcap").stdout
    for words in ("29, 10 a second", "76, 25 a second", "920 from -180.0 to 179.6 degrees", "at x 0.100 m"):
        assert words in text
    assert_mistake(wclm("simulate", "room", "a.mcap", "--duration", "3"), "a.mcap: exists already")
    assert wclm("simulate", "room", "a.mcap", "--duration", "3", "--overwrite").exit_code == 0


def test_wrong_simulations_are_refused(wclm: Wclm, tmp_path: Path) -> None:
    assert_mistake(wclm("simulate", "moon", "a.mcap"), "moon: no such world; there are ")
    assert_mistake(wclm("simulate", "room", "a.mcap", "--duration", "-1"), "duration must be positive")
    assert wclm("simulate", "room", "a.bag").exit_code == 2
    assert not list(tmp_path.iterdir())


def test_info_tells_what_is_wrong(wclm: Wclm, tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text(
        "".join(f"ODOM {0.1 * k} 0 0 0 0 0 {1e9 + k / 10} host {k / 10}\n" for k in range(50) if not 10 < k < 40)
    )
    text = wclm("info", "a.clf").stdout
    assert "2001-09-09 01:46:40 UTC" in text
    assert "warning     no scans" in text
    assert "a gap in the odometry" in text


def test_features_of_a_scan(wclm: Wclm, tmp_path: Path) -> None:
    result = wclm("features", "sim:room?duration=3", "--scan", "7", "--plot", "scan.png")
    assert result.exit_code == 0, result.output
    assert "sim:room, scan 7 at 0.713 s" in result.stdout
    assert re.search(r"^ +0 +\d+ +\d+\.\d{3} ", result.stdout, re.MULTILINE)
    assert (tmp_path / "scan.png").stat().st_size > 10_000
    assert_mistake(wclm("features", SHORT, "--scan", "29"), "has 29 scans, counted from 0; there is no scan 29")
    assert wclm("features", SHORT, "--scan", "-1").exit_code == 2


# eval


@pytest.fixture
def scored(tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text("".join(f"{k} {k} {0.01 * (k % 2)} 0 0 0 0 1\n" for k in range(20)))
    (tmp_path / "truth.tum").write_text("".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(20)))
    (tmp_path / "a.relations").write_text("".join(f"{k} {k + 3} 3 0 0 0 0 0\n" for k in range(15)))


@pytest.mark.usefixtures("scored")
def test_relations_are_scored(wclm: Wclm, tmp_path: Path) -> None:
    score = ("eval", "a.tum", "--relations", "a.relations")
    result = wclm(*score, "--json", "--plot", "a.png")
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert (figures["relations"], figures["trans_mean"], figures["missing"]) == (15, 0.01, 0)
    assert (tmp_path / "a.png").exists()
    assert "translation 0.0100 +- 0.0000 m" in wclm(*score).stdout


@pytest.mark.usefixtures("scored")
def test_relations_outside_the_trajectory_make_exit_status_1(wclm: Wclm, tmp_path: Path) -> None:
    with (tmp_path / "a.relations").open("a") as file:
        file.write("18 25 7 0 0 0 0 0\n")
    result = wclm("eval", "a.tum", "--relations", "a.relations", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["missing"] == 1
    assert "1 relations lie outside" in result.stderr


@pytest.mark.usefixtures("scored")
def test_a_reference_is_compared_with(wclm: Wclm, tmp_path: Path) -> None:
    result = wclm("eval", "a.tum", "--reference", "truth.tum", "--json", "--plot", "a.png")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["ate_rmse"] == pytest.approx(0.005, rel=0.01)
    assert (tmp_path / "a.png").exists()
    assert "20 at common times" in wclm("eval", "a.tum", "--reference", "truth.tum").stdout


@pytest.mark.usefixtures("scored")
def test_wrong_files_for_eval_are_one_line(wclm: Wclm, tmp_path: Path) -> None:
    (tmp_path / "bad.tum").write_text("1 2 3\n")
    (tmp_path / "empty.tum").write_text("")
    assert_mistake(wclm("eval", "bad.tum", "--reference", "truth.tum"), "bad.tum:1: expected 8 numbers")
    assert_mistake(wclm("eval", "empty.tum", "--relations", "a.relations"), "empty.tum: holds no line")
    assert_mistake(wclm("eval", "none.tum", "--relations", "a.relations"), "none.tum: No such file")
    assert_mistake(wclm("eval", "a.tum", "--relations", "bad.tum"), "bad.tum:1: expected 8 numbers (t1 t2")
    assert wclm("eval", "a.tum").exit_code == 2
    assert wclm("eval", "a.tum", "--reference", "truth.tum", "--relations", "a.relations").exit_code == 2

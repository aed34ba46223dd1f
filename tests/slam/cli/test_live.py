"""`wclm live` on an emulated robot, the two joined by pseudo terminals as by two cables."""

from __future__ import annotations

import io
import os
import resource
import signal
import socket
import subprocess
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun_cli
from rerun.chunk import RrdReader
from rich.console import Console

from drivers.devices.acquisition import Snapshot
from drivers.devices.supervisor import DeviceState, DeviceStatus
from drivers.messages import Odometry, Scan
from drivers.recordings.mcap import McapReader
from slam.cli.console import EXIT_USER_ERROR
from slam.cli.commands.live_dashboard import LiveDashboard
from slam.errors import OutputError
from slam.evaluation.metrics import score_reference
from slam.events import Notice, ScanTracked, StateChanged
from slam.io.output_dir import PICTURE, RESULTS, REVIEW, TRAJECTORY
from slam.io.tum import read_tum
from slam.visualisation.rerun_log import ViewerServer

from ..robot import LiveRun, Robot, wait_for

DRIVING = 12.0
"""Seconds."""
FEW = 3
"""Keyframes, of a robot that has hardly begun."""


@dataclass
class Driven:
    """A run that was ended with Ctrl-C, and what came of it.

    looks      the keyframes that two viewers were sent, one that came early and went, one that came late
    elsewhere  whether anything answered at another address than 127.0.0.1
    """

    run: LiveRun
    truth: Path
    recording: Path
    looks: list[set[int]]
    elsewhere: bool
    ended: tuple[int, str, str]
    report: dict[str, Any]


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Driven:
    """Twelve seconds in the office."""
    folder = tmp_path_factory.mktemp("live")
    with Robot(folder) as robot:
        run = LiveRun(robot, folder / "map", "--record", str(folder / "drive.mcap"))
        url = run.line("wclm: look on with: ").split()[-1]
        begun = time.monotonic()
        time.sleep(DRIVING / 3)
        looks = [keyframes_sent(url, folder / "early.rrd", more_than=FEW)]
        elsewhere = answers("127.0.0.2", int(url.split(":")[-1].split("/")[0]))
        time.sleep(max(0.0, begun + DRIVING - time.monotonic()))
        looks.append(keyframes_sent(url, folder / "late.rrd", more_than=len(looks[0])))
        ended = run.end()
        report = robot.stop()
    return Driven(run, robot.truth, folder / "drive.mcap", looks, elsewhere, ended, report)


def keyframes_sent(url: str, file: Path, more_than: int, patience: float = 60.0) -> set[int]:
    """What a viewer gets that comes now and goes after a while; on a busy computer it may have to come again until it
    gets more than a few.
    """
    end = time.monotonic() + patience
    found = watch(url, file)
    while len(found) <= more_than and time.monotonic() < end:
        file.unlink()
        found = watch(url, file)
    return found


def watch(url: str, file: Path, watching: float = 1.5) -> set[int]:
    """A short look by a viewer that saves what it is sent instead of showing it; the keyframes that it was sent."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        own_port = str(probe.getsockname()[1])
    program = Path(rerun_cli.__file__).with_name("rerun")
    command = [program, "--bind", "127.0.0.1", "--port", own_port, url, "--save", file]
    viewer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_for(file.exists, viewer, 20.0)
    time.sleep(watching)
    viewer.send_signal(signal.SIGTERM)
    viewer.wait(20.0)
    return keyframes_in(file)


def keyframes_in(file: Path) -> set[int]:
    """The keyframes whose pose is in a log."""
    found: set[int] = set()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "RRD file has no footer")
        chunks = RrdReader(str(file)).stream()
    for chunk in chunks:
        if chunk.entity_path == "/world/keyframe" and not chunk.is_static:
            found |= set(chunk.to_record_batch().column("keyframe").to_pylist())
    return found


def answers(address: str, port: int) -> bool:
    try:
        socket.create_connection((address, port), 1.0).close()
    except OSError:
        return False
    return True


def test_it_ends_with_everything_saved(driven: Driven) -> None:
    status, out, err = driven.ended
    assert status == 0, err
    assert {file.name for file in driven.run.out.iterdir()} == RESULTS - {PICTURE}
    assert err.splitlines()[-1] == "wclm: stopping; the map is saved. Ctrl-C again throws it away"
    assert f"results    {driven.run.out}" in out
    assert driven.run.summary["walls"] > 20


def test_it_knows_where_it_was(driven: Driven) -> None:
    figures = score_reference(read_tum(driven.run.out / TRAJECTORY), read_tum(driven.truth)).figures()
    assert figures["poses"] > 40 * DRIVING
    assert figures["ate_rmse"] < 0.05


def test_nothing_was_lost(driven: Driven) -> None:
    summary = driven.run.summary
    assert (summary["skipped"]["messages"], summary["warnings"]) == (0, [])
    assert summary["scans"] >= 9 * DRIVING
    for device in (0, 1):
        counters = driven.run.counters(device)
        for name in ("losses", "silences", "pauses", "checksum_failures", "bad", "resets", "jumps", "gaps"):
            assert counters.get(name, 0) == 0, name
    lidar, base = driven.run.counters(0), driven.run.counters(1)
    assert (lidar["messages"], base["messages"]) == (summary["scans"], summary["odometry"])
    assert driven.report["lidar"]["overrun"] == driven.report["base"]["overrun"] == 0
    revolution = lidar["samples"] / lidar["revolutions"]
    assert driven.report["lidar"]["samples"] - lidar["samples"] < revolution  # what was on its way at the end
    assert lidar["samples"] / revolution - lidar["revolutions"] < 2  # the first and the last are not whole
    assert driven.report["base"]["readings"] - base["good"] < 10


def test_the_recording_gives_the_same_path_every_time(driven: Driven, wclm: Any) -> None:
    live = (driven.run.out / TRAJECTORY).read_bytes()
    assert {type(message) for message in McapReader(driven.recording)} == {Scan, Odometry}
    for out in ("first", "second"):
        result = wclm("run", driven.recording, "--out", out, "--no-review")
        assert result.exit_code == 0, result.output
        assert Path(out, TRAJECTORY).read_bytes() == live


def test_viewers_come_late_and_see_everything(driven: Driven) -> None:
    early, late = driven.looks
    everything = set(range(driven.run.summary["keyframes"]))
    assert early == set(range(len(early)))
    assert FEW < len(early) < len(late)
    assert late == set(range(len(late)))
    assert keyframes_in(driven.run.out / REVIEW) == everything


def test_viewers_of_other_computers_are_not_let_in(driven: Driven) -> None:
    assert not driven.elsewhere


def test_viewers_get_a_port_of_their_own() -> None:
    with ViewerServer() as first, ViewerServer() as second, ViewerServer("0.0.0.0") as public:
        assert len({first.port, second.port, public.port}) == 3
        assert second.url == f"rerun+http://127.0.0.1:{second.port}/proxy"
        assert public.url == f"rerun+http://{socket.gethostname()}:{public.port}/proxy"
        with pytest.raises(OutputError, match="in use"):
            ViewerServer(port=second.port)
        second.release()
        ViewerServer(port=second.port).release()


def test_devices_that_break_down_cost_nothing_that_was_measured(tmp_path: Path) -> None:
    with Robot(tmp_path) as robot:
        run = LiveRun(robot, tmp_path / "map", "--no-review", "--record", str(tmp_path / "drive.mcap"))
        wait_until_recorded(run, tmp_path / "drive.mcap")
        (reader,) = Path(f"/proc/{run.process.pid}/task/{run.process.pid}/children").read_text().split()[-1:]
        os.kill(int(reader), signal.SIGKILL)
        status, out, err = run.wait()
    assert status == EXIT_USER_ERROR
    assert err.splitlines()[-1] == "wclm: the process that reads the devices ended unexpectedly"
    assert "Traceback" not in err
    assert "results " in out
    assert run.summary["walls"] > 3
    assert len(list(McapReader(tmp_path / "drive.mcap"))) == run.summary["scans"] + run.summary["odometry"]


def test_a_full_disk_ends_the_recording_and_not_the_map(tmp_path: Path) -> None:
    limit = 200_000

    def limit_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    with Robot(tmp_path) as robot:
        run = LiveRun(
            robot, tmp_path / "map", "--no-review", "--record", str(tmp_path / "drive.mcap"), preexec_fn=limit_files
        )
        said = run.line(f"wclm: {tmp_path / 'drive.mcap'}: cannot be written: File too large")
        status, _, err = run.end(signal.SIGTERM)
    assert said == "; the recording ends here and can be read, mapping goes on"
    assert (status, "Traceback" in err) == (0, False)
    assert run.summary["recorded"]["problem"] == "cannot be written: File too large"
    recorded = list(McapReader(tmp_path / "drive.mcap"))
    assert 0 < len(recorded) < run.summary["scans"] + run.summary["odometry"]


def wait_until_recorded(run: LiveRun, path: Path, size: int = 300_000) -> None:
    wait_for(lambda: path.exists() and path.stat().st_size > size, run.process)


def test_what_cannot_be_is_refused_before_anything_turns(wclm: Any, tmp_path: Path) -> None:
    devices = ("--lidar", "ld06:/dev/nothing", "--base", "kobuki:/dev/void")
    run = ("live", *devices, "--out", "map")
    wclm.refuses(*run, because=["no such port"])
    assert not list(tmp_path.iterdir())
    (tmp_path / "a.mcap").write_text("precious")
    wclm.refuses(*run, "--record", "a.mcap", because=["a.mcap: exists already"])
    wclm.refuses(*run, "--address", "192.0.2.1", because=["192.0.2.1: viewers cannot be served"])
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        wclm.refuses(*run, "--port", port, because=["127.0.0.1: viewers cannot be served at port", "in use"])
    for wrong in (devices[:2], devices[2:], ("--lidar", "create2:/dev/a", "--base", "kobuki:/dev/b")):
        assert wclm("live", *wrong, "--out", "map").exit_code == EXIT_USER_ERROR
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "mine.txt").write_text("precious")
    wclm.refuses(*run, because=["map: exists already"])


def test_the_terminal_shows_where_the_robot_is_and_how_its_devices_do(capsys: pytest.CaptureFixture[str]) -> None:
    dashboard = LiveDashboard()
    pose = np.array([1.25, -0.5, np.pi / 2])
    dashboard.handle(ScanTracked(time.time() - 0.25, pose, pose, 0.93, 7))
    dashboard.handle(StateChanged(3.0, "LOST", None))
    dashboard.handle(Notice(3.0, "the scan fits nowhere near; left out"))
    counters = {"messages": 42, "connections": 2, "losses": 1, "bad": 0}
    status = DeviceStatus("create2:/dev/a", False, DeviceState.LOST, "/dev/a", "Create 2", "unplugged", 0.1, counters)
    snapshot = Snapshot((status,), dropped=3, late=4)
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(dashboard.draw(snapshot, {("create2:/dev/a", "messages"): 66.7}))
    shown = console.export_text()
    for words in (
        "1.25 m, -0.50 m, 90°",
        "LOST",
        "93 %",
        "3, 4",
        "left out",
        "create2:/dev/a",
        "42",
        "66.7",
        "losses 1",
    ):
        assert words in shown
    assert "bad" not in shown
    assert capsys.readouterr().err == "wclm: the robot's place: LOST\n"

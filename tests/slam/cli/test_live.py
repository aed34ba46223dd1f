"""`wclm live` on an emulated robot, connected by pseudo terminals."""

from __future__ import annotations

import io
import json
import os
import resource
import signal
import socket
import subprocess
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun_cli
from rerun.chunk import RrdReader
from rich.console import Console

from drivers.devices.snapshot import Snapshot
from drivers.devices.supervisor import SILENCE_TIMEOUT, DeviceState, DeviceStatus
from drivers.messages import Odometry, Scan
from drivers.recordings.mcap import McapReader
from slam.cli.commands.live_dashboard import LiveDashboard
from slam.cli.console import EXIT_USER_ERROR
from slam.cli.status_file import StatusFile
from slam.errors import OutputError
from slam.evaluation.metrics import score_reference
from slam.events import Notice, ScanTracked, StateChanged
from slam.io.output_dir import PICTURE, RESULTS, REVIEW, SUMMARY, TRAJECTORY
from slam.io.tum import read_tum
from slam.visualisation.rerun_log import ViewerServer

from ..robot import SLOW_LIDAR, LiveRun, Robot, wait_for

pytestmark = pytest.mark.shared_run

DURATION = 6.0
"""Duration of the live run, seconds: long enough to see more than 20 walls, also if the viewers start at once."""
FIRST_KEYFRAMES = 3
"""Number of keyframes that the first viewer must exceed."""
ATTEMPTS = 3
"""Number of live runs at most: a computer that others use too may hold up an emulated device."""


@dataclass
class LiveSession:
    """A live run that was ended with Ctrl-C, and its results.

    views   keyframes that an early and a late viewer received
    foreign_address_answers  True if an address other than 127.0.0.1 accepted a connection
    ended   exit status, stdout and stderr
    report  report of the emulator
    states  content of the status file during the run and after it
    """

    run: LiveRun
    truth: Path
    recording: Path
    views: list[set[int]]
    foreign_address_answers: bool
    ended: tuple[int, str, str]
    report: dict[str, Any]
    states: list[dict[str, Any]]

    @property
    def was_held_up(self) -> bool:
        """True if the computer was held up for so long that an emulated device was silent, or was not read."""
        pauses = [self.run.counters(device)["pauses"] for device in (0, 1)]
        return self.report["longest_pause"] > SILENCE_TIMEOUT / 2 or any(pauses)


@pytest.fixture(scope="module")
def live_session(tmp_path_factory: pytest.TempPathFactory) -> LiveSession:
    """Live run on a computer that was not held up; the last of ATTEMPTS if it always was."""
    for _ in range(ATTEMPTS):
        session = run_live(tmp_path_factory.mktemp("live"))
        if not session.was_held_up:
            break
    return session


def run_live(folder: Path) -> LiveSession:
    """Run live for DURATION seconds in the office."""
    with Robot(folder, "office", *SLOW_LIDAR) as robot:
        options = ("--record", str(folder / "drive.mcap"), "--status", str(folder / "status.json"))
        run = LiveRun(robot, folder / "map", *options)
        url = run.line("wclm: view with: ").split()[-1]
        begun = time.monotonic()
        time.sleep(DURATION / 3)
        states = [json.loads((folder / "status.json").read_text())]
        run.process.send_signal(signal.SIGUSR1)  # saving must not change the results
        views = [keyframes_sent(url, folder / "early.rrd", more_than=FIRST_KEYFRAMES)]
        foreign_address_answers = accepts_connection("127.0.0.2", int(url.split(":")[-1].split("/")[0]))
        time.sleep(max(0.0, begun + DURATION - time.monotonic()))
        views.append(keyframes_sent(url, folder / "late.rrd", more_than=len(views[0])))
        ended = run.end()
        report = robot.stop()
    states.append(json.loads((folder / "status.json").read_text()))
    return LiveSession(run, robot.truth, folder / "drive.mcap", views, foreign_address_answers, ended, report, states)


def keyframes_sent(url: str, file: Path, more_than: int, timeout: float = 120.0) -> set[int]:
    """Return the keyframes that a viewer receives; repeat until there are `more_than` or the timeout is over."""
    end = time.monotonic() + timeout
    found = watch(url, file)
    while len(found) <= more_than and time.monotonic() < end:
        file.unlink()
        found = watch(url, file)
    return found


def watch(url: str, file: Path, watching: float = 1.5) -> set[int]:
    """Run a viewer for a short time, which saves what it receives; return the received keyframes."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        own_port = str(probe.getsockname()[1])
    program = Path(rerun_cli.__file__).with_name("rerun")
    command = [program, "--bind", "127.0.0.1", "--port", own_port, url, "--save", file]
    viewer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_for(file.exists, viewer, 60.0)
    time.sleep(watching)
    viewer.send_signal(signal.SIGTERM)
    viewer.wait(60.0)
    return keyframes_in(file)


def keyframes_in(file: Path) -> set[int]:
    """Return the keyframes whose pose is in a log."""
    found: set[int] = set()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "RRD file has no footer")
        chunks = RrdReader(str(file)).stream()
    for chunk in chunks:
        if chunk.entity_path == "/world/keyframe" and not chunk.is_static:
            found |= set(chunk.to_record_batch().column("keyframe").to_pylist())
    return found


def accepts_connection(address: str, port: int) -> bool:
    try:
        socket.create_connection((address, port), 1.0).close()
    except OSError:
        return False
    return True


def test_ctrl_c_saves_all_results(live_session: LiveSession) -> None:
    status, out, err = live_session.ended
    assert status == 0, err
    assert {file.name for file in live_session.run.out.iterdir()} == RESULTS - {PICTURE}
    assert err.splitlines()[-1] == "wclm: stopping and saving the map; Ctrl-C again discards it"
    assert f"results    {live_session.run.out}" in out
    assert live_session.run.summary["walls"] > 20


def test_path_is_accurate(live_session: LiveSession) -> None:
    figures = score_reference(read_tum(live_session.run.out / TRAJECTORY), read_tum(live_session.truth)).figures()
    assert figures["poses"] > 40 * DURATION
    assert figures["ate_rmse"] < 0.05


def test_no_measurement_is_lost(live_session: LiveSession) -> None:
    summary = live_session.run.summary
    # a busy host may stop the emulated wheels for a moment, and starts the lidar later than the wheels; neither is a
    # loss, and the path is tested above
    harmless = ("odometry was far off", "before the first scan")
    losses = [warning for warning in summary["warnings"] if not any(text in warning for text in harmless)]
    assert (summary["skipped"]["messages"], losses) == (0, [])
    assert summary["scans"] >= 4.5 * DURATION
    for device in (0, 1):
        counters = live_session.run.counters(device)
        for name in ("losses", "silences", "pauses", "checksum_failures", "bad", "resets", "jumps", "gaps"):
            assert counters.get(name, 0) == 0, (name, counters, live_session.report["longest_pause"])
    lidar, base = live_session.run.counters(0), live_session.run.counters(1)
    assert (lidar["messages"], base["messages"]) == (summary["scans"], summary["odometry"])
    assert live_session.report["lidar"]["overrun"] == live_session.report["base"]["overrun"] == 0
    revolution = lidar["samples"] / lidar["revolutions"]
    assert live_session.report["lidar"]["samples"] - lidar["samples"] < revolution  # the last packets
    assert lidar["samples"] / revolution - lidar["revolutions"] < 2  # the first and the last revolution are incomplete
    assert live_session.report["base"]["readings"] - base["good"] < 10


def test_the_status_file_shows_the_run(live_session: LiveSession) -> None:
    during, after = live_session.states
    assert (during["running"], after["running"], after["failure"]) == (True, False, "")
    assert [device["state"] for device in during["devices"]] == ["running", "running"]
    assert (after["scans"], after["map"]["walls"] > 10) == (live_session.run.summary["scans"], True)
    assert after["map"]["keyframes"] == live_session.run.summary["keyframes"]
    assert after["saved"] == (live_session.run.out / SUMMARY).stat().st_mtime
    assert len(after["pose"]) == 3
    assert after["recording"] == {"seconds": pytest.approx(DURATION, abs=30.0), "problem": ""}
    assert after["free_disk"] > 0.0


def test_no_drive_command_is_sent_without_the_option(live_session: LiveSession) -> None:
    assert live_session.report["base"]["velocities"] == 0


def test_mapping_the_recording_gives_the_same_path(live_session: LiveSession, wclm: Any) -> None:
    live = (live_session.run.out / TRAJECTORY).read_bytes()
    assert {type(message) for message in McapReader(live_session.recording)} == {Scan, Odometry}
    result = wclm("run", live_session.recording, "--out", "again", "--no-review")
    assert result.exit_code == 0, result.output
    assert Path("again", TRAJECTORY).read_bytes() == live


def test_viewers_that_connect_late_get_all_keyframes(live_session: LiveSession) -> None:
    early, late = live_session.views
    everything = set(range(live_session.run.summary["keyframes"]))
    assert early == set(range(len(early)))
    assert FIRST_KEYFRAMES < len(early) < len(late)
    assert late == set(range(len(late)))
    assert keyframes_in(live_session.run.out / REVIEW) == everything


def test_viewers_are_served_on_the_local_address_only(live_session: LiveSession) -> None:
    assert not live_session.foreign_address_answers


def test_each_viewer_server_has_its_own_port() -> None:
    with ViewerServer() as first, ViewerServer() as second, ViewerServer("0.0.0.0") as public:
        assert len({first.port, second.port, public.port}) == 3
        assert second.url == f"rerun+http://127.0.0.1:{second.port}/proxy"
        assert public.url == f"rerun+http://{socket.gethostname()}:{public.port}/proxy"
        with pytest.raises(OutputError, match="in use"):
            ViewerServer(port=second.port)
        second.release()
        ViewerServer(port=second.port).release()


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """Robot of several runs, one after the other."""
    with Robot(tmp_path_factory.mktemp("robot"), "office", *SLOW_LIDAR) as robot:
        yield robot


def test_a_failure_of_the_reader_process_keeps_earlier_measurements(tmp_path: Path, robot: Robot) -> None:
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
    recorded, mapped = list(McapReader(tmp_path / "drive.mcap")), read_tum(run.out / TRAJECTORY).stamps
    assert mapped[-1] - recorded[-1].stamp < 1.5  # the recorder was in the reader process


def test_a_full_disk_ends_the_recording_but_not_the_mapping(tmp_path: Path, robot: Robot) -> None:
    limit = 300_000  # some seconds, more than is flushed at once

    def limit_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    run = LiveRun(
        robot, tmp_path / "map", "--no-review", "--record", str(tmp_path / "drive.mcap"), preexec_fn=limit_files
    )
    message = run.line(f"wclm: {tmp_path / 'drive.mcap'}: cannot be written: File too large")
    status, _, err = run.end(signal.SIGTERM)
    assert message == "; the recording ends here and is readable, mapping continues"
    assert (status, "Traceback" in err) == (0, False)
    assert run.summary["recorded"]["problem"] == "cannot be written: File too large"
    recorded = list(McapReader(tmp_path / "drive.mcap"))
    assert 0 < len(recorded) < run.summary["scans"] + run.summary["odometry"]


def wait_until_recorded(run: LiveRun, path: Path, size: int = 150_000) -> None:
    wait_for(lambda: path.exists() and path.stat().st_size > size, run.process)


def test_invalid_arguments_are_refused_before_devices_start(wclm: Any, tmp_path: Path) -> None:
    devices = ("--lidar", "ld06:/dev/nothing", "--base", "kobuki:/dev/void")
    run = ("live", *devices, "--out", "map")
    wclm.refuses(*run, because=["no such port"])
    assert not list(tmp_path.iterdir())
    (tmp_path / "a.mcap").write_text("precious")
    wclm.refuses(*run, "--record", "a.mcap", because=["a.mcap: exists already"])
    wclm.refuses(*run, "--record", "none/a.mcap", because=["none/a.mcap: cannot be written: its directory does not"])
    (tmp_path / "map").mkdir()
    for option, file in (("--record", "map/a.mcap"), ("--status", "map/s.json")):
        wclm.refuses(*run, option, file, because=[option, f"{file}: must not be in the output directory map"])
    wclm.refuses(*run, "--status", "map", "--out", "other", because=["map: is a directory"])
    (tmp_path / "map").rmdir()
    wclm.refuses(*run, "--base", "create2:/dev/full", because=["2 wheel bases are given"])
    swapped = ("live", "--lidar", "ld06:/dev/nothing + kobuki:/dev/void", "--out", "map")
    wclm.refuses(*swapped, because=["--lidar: kobuki:/dev/void is a wheel base, for --base"])
    wclm.refuses(*run, "--address", "192.0.2.1", because=["192.0.2.1: viewers cannot be served"])
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        wclm.refuses(*run, "--port", port, because=["127.0.0.1: viewers cannot be served at port", "in use"])
    for wrong in (devices[:2], devices[2:], ("--lidar", "create2:/dev/a", "--base", "kobuki:/dev/b")):
        assert wclm("live", *wrong, "--out", "map").exit_code == EXIT_USER_ERROR
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "mine.txt").write_text("precious")
    wclm.refuses(*run, because=["map: exists already"])


def test_the_status_file_is_right_if_the_wall_clock_is_set_during_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a computer without a battery-backed clock that gets the time from the network."""
    status = StatusFile(tmp_path / "status.json", tmp_path / "map")
    status.handle(ScanTracked(time.monotonic() + 999.0, np.zeros(3), np.zeros(3), 0.9, 1))
    now = time.time() + 1e7
    monkeypatch.setattr(time, "time", lambda: now)
    status.close(Snapshot(clock_offset=1000.0))
    content = json.loads((tmp_path / "status.json").read_text())
    assert content["time"] == now
    assert 1.0 <= content["delay"] < 1e5
    assert 0.0 <= content["seconds"] < 1e5


def test_dashboard_shows_pose_status_and_device_counters(capsys: pytest.CaptureFixture[str]) -> None:
    dashboard = LiveDashboard()
    pose = np.array([1.25, -0.5, np.pi / 2])
    dashboard.handle(ScanTracked(time.monotonic() + 900.0, pose, pose, 0.93, 7))
    dashboard.handle(StateChanged(3.0, "LOST", None))
    dashboard.handle(Notice(3.0, "the scan fits nowhere near; left out"))
    counters = {"messages": 42, "connections": 2, "losses": 1, "bad": 0}
    status = DeviceStatus("create2:/dev/a", False, DeviceState.LOST, "/dev/a", "Create 2", "unplugged", 0.1, counters)
    snapshot = Snapshot((status,), dropped=3, late=4, clock_offset=1000.0)
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(dashboard.render(snapshot, {("create2:/dev/a", "messages"): 66.7}))
    shown = console.export_text()
    for words in (
        "1.25 m, -0.50 m, 90°",
        "delay 100.",
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
    assert capsys.readouterr().err == "wclm: localisation status: LOST\n"

"""`wclm review`: viewer, browser and summary, for complete logs, old logs and logs of killed runs."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlparse

import psutil
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from typer.testing import CliRunner

from slam.cli.app import app
from slam.events import Event, KeyframeAdded
from slam.io.output_dir import REVIEW, SUMMARY
from slam.visualisation.rerun_log import rrd_writer
from slam.visualisation.rerun_log.combined_log import write_combined_log
from slam.visualisation.rerun_log.log_files import find_log

from ..closure_log import write
from ..corridor import keyframes_in

WCLM = "from slam.cli import main; main()"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output directory of a short run."""
    out = tmp_path_factory.mktemp("session") / "room"
    done = CliRunner().invoke(app, ["run", "sim:room?duration=5&lidar=short", "--out", str(out)])
    assert done.exit_code == 0, done.output
    return out


@contextmanager
def running(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    command_line = [sys.executable, "-c", WCLM, *map(str, arguments)]
    process = subprocess.Popen(
        command_line,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # ignored in tests that run in the background
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


# --- the summary


def test_summary_starts_no_viewer(wclm: Any, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "Popen", None)
    result = wclm("review", session, "--summary")
    assert result.exit_code == 0, result.output
    summary = json.loads((session / SUMMARY).read_text())
    assert f"{summary['keyframes']} keyframes, {summary['walls']} walls" in result.stdout
    assert "health" in result.stdout
    assert "loops" in result.stdout
    assert "residuals   worst factors at keyframe" in result.stdout
    assert "d² = " in result.stdout


def test_summary_lists_the_loop_closures_of_the_log(wclm: Any, closure_log: Path) -> None:
    text = wclm("review", closure_log, "--summary").stdout
    assert "1 accepted" in text
    assert "accepted  loop 1, x100 at x3, moved by 1.80 m, 1 wall merged" in text


def test_summary_works_without_a_log(wclm: Any, session: Path, tmp_path: Path) -> None:
    shutil.copytree(session, tmp_path / "bare")
    (tmp_path / "bare" / REVIEW).unlink()
    text = wclm("review", "bare", "--summary").stdout
    assert "residuals   unknown: there is no log" in text
    wclm.refuses("review", "bare", "--web", because=["contains no review.rrd", "--no-review"])


# --- errors


def test_files_that_are_no_log_are_refused(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    (tmp_path / "broken.rrd").write_bytes(b"RRF2" + bytes(200))
    wclm.refuses("review", "nowhere", "--web", because=["nowhere", "no such session"])
    wclm.refuses("review", "notes.txt", "--web", because=["notes.txt", "not a review log"])
    wclm.refuses("review", "broken.rrd", "--summary", because=["broken.rrd", "not a review log"])


def test_without_a_display_the_error_names_the_alternatives(wclm: Any, session: Path) -> None:
    wclm.refuses("review", session, because=["no display", "--web", "--summary"])
    wclm.refuses("review", "nowhere", because=["nowhere", "no such session"])


# --- the viewer


def test_native_viewer_accepts_local_connections_only(
    wclm: Any, session: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    kept = tmp_path / "arguments"
    fake = tmp_path / "viewer"
    fake.write_text(f'#!/bin/sh\necho "$@" > {kept}\ntest -s "$1"\n')
    fake.chmod(0o755)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("slam.visualisation.rerun_log.viewer.viewer_executable", lambda: str(fake))
    result = wclm("review", session)
    assert result.exit_code == 0, result.output
    log, *options = kept.read_text().split()
    assert options == ["--bind", "127.0.0.1", "--port", "auto"]
    assert not Path(log).exists()  # the temporary log is removed


def listening(process: psutil.Process) -> set[tuple[str, int]]:
    """Return the addresses and ports on which a process and its children listen."""
    found = set()
    for one in [process, *process.children(recursive=True)]:
        for connection in one.net_connections("inet"):
            if connection.status == psutil.CONN_LISTEN:
                found.add((connection.laddr.ip, connection.laddr.port))
    return found


def test_web_viewer_accepts_local_connections_only(session: Path) -> None:
    with running("review", session, "--web") as process:
        assert process.stdout is not None
        page = process.stdout.readline().strip()
        data = parse_qs(urlparse(page).query)["url"][0]
        ports = {urlparse(page).port, urlparse(data.replace("rerun+", "")).port}
        assert listening(psutil.Process(process.pid)) == {("127.0.0.1", port) for port in ports}
        assert b"<canvas" in urllib.request.urlopen(page, timeout=60).read()
        servers = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert not any(server.is_running() and server.status() != psutil.STATUS_ZOMBIE for server in servers)


SERVER_WHOSE_PORT_IS_TAKEN_ONCE = """#!{python}
import socket, sys
from pathlib import Path
marker = Path({marker!r})
if not marker.exists():
    marker.touch()
    sys.exit(1)
options = sys.argv[1:]
ports = [int(options[options.index(name) + 1]) for name in ("--port", "--web-viewer-port")]
for server in [socket.create_server(("127.0.0.1", port)) for port in ports]:
    server.accept()
"""


def test_web_viewer_is_started_again_if_its_port_was_taken_meanwhile(
    wclm: Any, session: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    server = tmp_path / "server"
    marker = str(tmp_path / "started")
    server.write_text(SERVER_WHOSE_PORT_IS_TAKEN_ONCE.format(python=sys.executable, marker=marker))
    server.chmod(0o755)
    monkeypatch.setattr("slam.visualisation.rerun_log.viewer.viewer_executable", lambda: str(server))
    result = wclm("review", session, "--web")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("http://127.0.0.1:")


def test_error_names_a_port_that_is_in_use(wclm: Any, session: Path) -> None:
    with occupied_port() as port:
        wclm.refuses("review", session, "--web", "--port", port, because=["127.0.0.1", str(port)])


@contextmanager
def occupied_port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


# --- old logs, and logs of killed runs


def test_an_old_log_is_shown_with_the_current_layout(tmp_path: Path) -> None:
    old = rr.RecordingStream("wclm-slam", recording_id="old")
    old.save(tmp_path / "old.rrd", default_blueprint=rr.blueprint.Blueprint(rr.blueprint.TextDocumentView(name="old")))
    old.set_time("keyframe", sequence=3)
    old.log("world/map/walls", rr.LineStrips3D([[[0, 0, 0], [40, 0, 0]], [[0, 0, 0], [0, 30, 0]]]))
    old.disconnect()
    write_combined_log([find_log(tmp_path / "old.rrd")], ["old"], tmp_path / "ready.rrd")
    (layout,) = RrdReader(tmp_path / "ready.rrd").blueprints()
    names = set()
    for chunk in RrdReader(tmp_path / "ready.rrd").stream(store=layout):
        batch = chunk.to_record_batch()
        for column in batch.schema.names:
            if column.endswith(":display_name"):
                names |= {text for row in batch.column(column).to_pylist() for text in row or []}
    assert "Map" in names
    assert not {"old", "Before / after", "Last loop"} & names  # nothing in it is of a loop


def test_a_truncated_log_opens_up_to_its_end(
    corridor: tuple[Path, list[Event]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rrd_writer, "FLUSH_PERIOD", 0.02)  # several chunks within one second
    events = corridor[1][: len(corridor[1]) // 2]
    keyframes = sum(isinstance(event, KeyframeAdded) for event in events)
    whole = write(tmp_path / "whole.rrd", events).read_bytes()
    for share in (0.5, 0.77):  # within a chunk
        cut = tmp_path / "cut.rrd"
        cut.write_bytes(whole[: int(share * len(whole))])
        write_combined_log([find_log(cut)], ["cut"], tmp_path / "ready.rrd")
        assert len(keyframes_in(tmp_path / "ready.rrd")) > 0.3 * share * keyframes


@pytest.mark.slow
def test_the_log_of_a_killed_run_is_found_and_opens(wclm: Any, tmp_path: Path) -> None:
    out = tmp_path / "office"
    with running("run", "sim:office?lidar=short", "--out", out) as process:
        deadline = time.monotonic() + 200  # includes compilation
        while not any(log.stat().st_size > 500_000 for log in tmp_path.glob(f".office-*/{REVIEW}")):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.kill(process.pid, signal.SIGKILL)
        process.wait(60)
    assert not out.exists()
    log = find_log(out)
    assert not log.ended
    write_combined_log([log], ["office"], tmp_path / "ready.rrd")
    found = keyframes_in(tmp_path / "ready.rrd")
    assert found == set(range(len(found)))
    assert len(found) > 20
    result = wclm("review", out, "--summary")
    assert result.exit_code == 0, result.output
    assert "the run has not ended, or was killed" in result.stdout
    assert str(log.directory) in result.stdout
    assert f"{len(found)} keyframes" in result.stdout

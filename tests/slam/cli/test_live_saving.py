"""Saving during `wclm live`, and what is left if the run is killed or its terminal is gone."""

from __future__ import annotations

import fcntl
import gc
import json
import os
import pty
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from slam.cli.autosave import LARGEST_SHARE, Autosave
from slam.cli.terminal_keys import TerminalKeys
from slam.io.output_dir import (
    CONFIG,
    KEYFRAMES,
    MAP,
    PICTURE,
    RESULTS,
    SESSION,
    SUMMARY,
    TRAJECTORY,
    OutputDirectory,
)
from slam.io.sessions import read_session

from ..robot import SLOW_LIDAR, LiveRun, Robot, wait_for

SAVED = {TRAJECTORY, KEYFRAMES, MAP, CONFIG, SUMMARY, SESSION}


def use_as_terminal() -> None:
    """Make standard input the controlling terminal of a new session."""
    os.setsid()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored if the tests were started with nohup


def names(folder: Path) -> set[str]:
    return {entry.name for entry in folder.iterdir()}


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """Robot of several runs, one after the other."""
    with Robot(tmp_path_factory.mktemp("robot"), "office", *SLOW_LIDAR) as robot:
        yield robot


def test_a_run_is_saved_and_switched_by_commands_and_keys_and_ends_with_its_terminal(
    tmp_path: Path, robot: Robot, wclm: Any
) -> None:
    out, status = tmp_path / "a" / "map", tmp_path / "status.json"
    out.parent.mkdir()
    terminal, inner = pty.openpty()
    options = ("--no-serve", "--status", str(status))
    run = LiveRun(robot, out, *options, stdin=inner, preexec_fn=use_as_terminal)
    os.close(inner)
    assert_saved_by_command_and_key(run, terminal, wclm)
    assert_switched_by_command_and_key(run, terminal, status, wclm)
    os.close(terminal)  # sends SIGHUP, as the end of an SSH session does
    code, _, err = run.wait()
    assert (code, "Traceback" in err) == (0, False), err
    assert names(out) == RESULTS - {PICTURE}
    assert names(out.parent) == {"map", "stdout", "stderr"}
    assert names(out / SESSION)
    assert "unfinished" not in run.summary
    wclm.refuses("mode", out, "mapping", because=["map: no live run is writing it"])


def assert_saved_by_command_and_key(run: LiveRun, terminal: int, wclm: Any) -> None:
    wait_for(lambda: wclm("save", run.out).exit_code == 0, run.process)
    assert names(run.out) == SAVED
    assert run.summary["unfinished"]
    first = run.out.stat().st_ino
    os.write(terminal, b"s")
    wait_for(lambda: run.out.exists() and run.out.stat().st_ino != first, run.process)


def assert_switched_by_command_and_key(run: LiveRun, terminal: int, status: Path, wclm: Any) -> None:
    """The run ends in the localization mode; keyframes are added in the other one only."""

    def frozen() -> bool:
        return bool(json.loads(status.read_text())["frozen"])

    def saved_keyframes() -> int:
        assert wclm("save", run.out).exit_code == 0
        return int(run.summary["keyframes"])

    assert wclm("mode", run.out, "localization").exit_code == 0
    wait_for(frozen, run.process)
    assert wclm("mode", run.out).stdout == f"{run.out}: localization\n"
    assert wclm("mode", run.out, "localization").exit_code == 0
    keyframes = saved_keyframes()
    time.sleep(2.0)
    assert saved_keyframes() == keyframes
    os.write(terminal, b"l")
    wait_for(lambda: not frozen(), run.process)
    assert wclm("mode", run.out).stdout == f"{run.out}: mapping\n"
    wait_for(lambda: saved_keyframes() > keyframes, run.process)
    assert wclm("mode", run.out, "localization").exit_code == 0


@pytest.mark.slow
def test_a_killed_run_leaves_the_saved_map_and_is_recovered(tmp_path: Path, robot: Robot, wclm: Any) -> None:
    out = tmp_path / "map"
    run = LiveRun(robot, out)
    wait_for(lambda: wclm("save", out).exit_code == 0, run.process)
    run.end(signal.SIGKILL)
    assert names(out) == SAVED
    assert read_session(out).slam_state.mapper.keyframe_count == run.summary["keyframes"]
    (left,) = tmp_path.glob(".map-*")
    wclm.refuses("save", out, because=["map: no live run is writing it"])
    again = wclm("live", "--lidar", "ld06:/dev/nothing", "--base", "kobuki:/dev/void", "--out", out)
    assert f"a killed run left {left} behind" in again.stderr
    assert f"wclm recover {out}" in again.stderr
    recovered = wclm("recover", out)
    assert recovered.exit_code == 0, recovered.output
    assert names(out) == RESULTS - {PICTURE}
    assert not left.exists()
    wclm.refuses("recover", out, because=["map: no killed run has left anything beside it"])


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), ValueError("a bug")])
def test_a_failing_save_does_not_end_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: Exception
) -> None:
    monkeypatch.setattr("slam.cli.autosave.PERIOD", 0.0)
    failures = [error, error, None]

    def write(place: Path) -> None:
        (place / SUMMARY).write_text("{}")
        if (failure := failures.pop(0)) is not None:
            raise failure

    output = OutputDirectory(tmp_path / "map")
    with output, Autosave(output, lambda: write, TerminalKeys()) as autosave:
        while failures:
            autosave.poll()
            time.sleep(0.001)
    (message,) = capsys.readouterr().err.splitlines()  # the second one is equal
    assert message.startswith(f"wclm: {tmp_path / 'map'}: ")
    assert message.endswith("; the run goes on")


def test_a_state_that_cannot_be_copied_does_not_end_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("slam.cli.autosave.PERIOD", 0.0)

    def prepare() -> Callable[[Path], None]:
        raise ValueError("a bug")

    output = OutputDirectory(tmp_path / "map")
    with output, Autosave(output, prepare, TerminalKeys()) as autosave:
        autosave.poll()
        autosave.poll()
    assert capsys.readouterr().err == f"wclm: {tmp_path / 'map'}: not saved: a bug; the run goes on\n"


def test_the_memory_that_a_save_needed_is_returned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also that of the copy of the run, which grows with the drive, and that of the code of libraries."""
    steps: list[str] = []
    monkeypatch.setattr("slam.cli.autosave.PERIOD", 0.0)
    monkeypatch.setattr("slam.cli.autosave.return_freed_memory", lambda: steps.append("returned"))
    monkeypatch.setattr("slam.cli.autosave.return_code_of_imports", lambda: steps.append("code returned"))

    class Copy:
        def __del__(self) -> None:
            steps.append("released")

    def prepare() -> Callable[[Path], None]:
        copy = Copy()

        def write(place: Path) -> None:
            (place / SUMMARY).write_text("{}")
            steps.append("written" if copy else "")

        return write

    with (output := OutputDirectory(tmp_path / "map")), Autosave(output, prepare, TerminalKeys()) as autosave:
        autosave.poll()
        wait_until_saved()
    assert steps == ["written", "released", "code returned", "returned"]


def test_a_save_leaves_no_classes_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They refer to themselves, and a live run looks for such objects once in hours."""
    monkeypatch.setattr("slam.cli.autosave.PERIOD", 0.0)

    def write(place: Path) -> None:
        (place / SUMMARY).write_text("{}")

    classes: list[int] = []
    with (output := OutputDirectory(tmp_path / "map")), Autosave(output, lambda: write, TerminalKeys()) as autosave:
        gc.disable()
        for _ in range(4):
            autosave.poll()
            wait_until_saved()
            classes.append(sum(isinstance(thing, type) for thing in gc.get_objects()))
        gc.enable()
    assert classes[1] == classes[-1]


@pytest.mark.parametrize("duration", [0.0, 7.0, 15.0])
def test_at_most_a_minute_of_the_map_is_not_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, duration: float
) -> None:
    """Saves take up to 15 s, as on a busy computer; it is killed right before one ends."""
    now, saved, lost = [1000.0], [1000.0], []
    monkeypatch.setattr("slam.cli.autosave.time.monotonic", lambda: now[0])

    def prepare() -> Callable[[Path], None]:
        state = now[0]

        def write(place: Path) -> None:
            (place / SUMMARY).write_text("{}")
            now[0] += duration
            lost.append(now[0] - saved[-1])
            saved.append(state)

        return write

    with (output := OutputDirectory(tmp_path / "map")), Autosave(output, prepare, TerminalKeys()) as autosave:
        while now[0] < 1400.0:
            autosave.poll()
            wait_until_saved()
            now[0] += 1.0
    assert len(lost) >= 6
    assert max(lost) <= 60.0


def wait_until_saved() -> None:
    """Wait for the threads that save."""
    for thread in threading.enumerate():
        if thread.name == "autosave":
            thread.join()


def test_saves_that_take_long_are_made_less_often(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam.cli.autosave.PERIOD", 0.0)
    began: list[float] = []

    def write(place: Path) -> None:
        (place / SUMMARY).write_text("{}")
        began.append(time.monotonic())
        time.sleep(0.1)

    with (output := OutputDirectory(tmp_path / "map")), Autosave(output, lambda: write, TerminalKeys()) as autosave:
        while len(began) < 3:
            autosave.poll()
            time.sleep(0.001)
    assert min(after - before for before, after in pairwise(began)) >= 0.1 / LARGEST_SHARE - 0.05


LOST_IN_A_CALLBACK = """
import ctypes, os, signal, sys, time
from slam.cli.signals import exit_on_signals

number = int(sys.argv[1])
signal.signal(number, signal.SIG_DFL)  # SIGHUP is ignored if the tests were started with nohup
exit_on_signals()
callback = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), number) or time.sleep(0.01))
callback()
while True:
    time.sleep(0.01)
"""


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGHUP, 128 + signal.SIGHUP)]
)
def test_a_signal_within_a_callback_of_a_compiler_is_not_lost(number: int, status: int) -> None:
    ended = subprocess.run([sys.executable, "-c", LOST_IN_A_CALLBACK, f"{number}"], timeout=200.0, check=False)
    assert ended.returncode == status


def test_a_command_started_with_nohup_ignores_a_lost_terminal() -> None:
    code = f"import os; os.kill(os.getpid(), {signal.SIGHUP}); print('goes on')"
    command = "import signal; from slam.cli.signals import exit_on_signals; exit_on_signals(); " + code
    ended = subprocess.run(
        [sys.executable, "-c", command],
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, ended.stdout) == (0, "goes on\n")

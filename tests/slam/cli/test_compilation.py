"""The message that a command compiles: once, if that takes long."""

import subprocess
import sys

import pytest
from numba import njit
from numba.core.event import install_listener

from slam.cli import compilation
from slam.cli.compilation_message import CompilationMessage

from .test_console import wait_for_timers


def test_compiling_for_long_prints_one_message(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam.cli.compilation_message.SLOW_SECONDS", 1e-6)
    inner = njit(lambda x: x + 1)
    outer = njit(lambda x: 2 * inner(x))
    with install_listener("numba:compile", CompilationMessage("compiling")):
        assert outer(1) == 4
        wait_for_timers()
        assert outer(1.5) == 5.0  # compiled again, for another type
    wait_for_timers()
    assert capsys.readouterr().err == "wclm: compiling\n"


def test_the_first_compilation_prints_one_message(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def warm_up() -> None:
        njit(lambda x: x + 1)(1)
        wait_for_timers()

    for module in ("console", "compilation_message"):
        monkeypatch.setattr(f"slam.cli.{module}.SLOW_SECONDS", 1e-6)
    monkeypatch.setattr("slam.preprocessing.extraction.is_compiled", lambda: False)
    monkeypatch.setattr("slam.warmup.warm_up", warm_up)
    compilation.compile_all.__wrapped__()
    assert capsys.readouterr().err == f"wclm: {compilation.COMPILING}\n"


def test_compiling_for_a_short_time_prints_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam.cli.compilation_message.SLOW_SECONDS", 120.0)
    with install_listener("numba:compile", CompilationMessage("compiling")):
        assert njit(lambda x: x + 1)(1) == 2
    wait_for_timers()
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_every_command_announces_that_it_compiles_and_none_imports_the_compiler_for_that() -> None:
    code = """
import sys
from threading import Timer, enumerate as threads

import slam.cli.console
from slam.cli.compilation import announce_compilation

slam.cli.console.SLOW_SECONDS = 1e-6
announce_compilation()
assert "numba" not in sys.modules

import drivers.compiled
from numba import njit

njit(lambda x: x + 1)(1)
for timer in threads():
    if isinstance(timer, Timer):
        timer.join()
"""
    answer = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=250)
    assert answer.stderr == f"wclm: {compilation.COMPILING}\n"

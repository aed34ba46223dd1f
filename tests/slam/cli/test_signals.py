"""Signals that end a command."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from slam.geometry.angles import wrap_angle

# Sends a signal in a callback of LLVM, which gets the code of a function there that was compiled before.
PROGRAM = """
import os, signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from numba.core.codegen import CPUCodeLibrary
from slam.cli.signals import exit_on_signals

load = CPUCodeLibrary._object_getbuffer_hook.__func__
def interrupt(library, module):
    code = load(library, module)
    if code is not None:
        os.kill(os.getpid(), {number})
        time.sleep(0.0)  # it is handled here
    return code
CPUCodeLibrary._object_getbuffer_hook = classmethod(interrupt)
exit_on_signals()

from slam.geometry.angles import wrap_angle
assert wrap_angle(0.5) == 0.5
time.sleep(600)  # ends when the signal is handled again
print("not interrupted")
"""


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_while_a_function_is_loaded_ends_the_command(number: signal.Signals) -> None:
    wrap_angle(0.5)  # its code is on disk now
    command = [sys.executable, "-c", PROGRAM.format(number=int(number))]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == (-signal.SIGINT if number == signal.SIGINT else 128 + signal.SIGTERM), result.stderr
    assert not result.stdout
    assert "Exception ignored" not in result.stderr


EARLY = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)

class Interrupting:
    def find_spec(self, name, *rest):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.0)  # it is handled here

sys.meta_path.insert(0, Interrupting())
from slam.cli import main
main()
"""


@pytest.mark.parametrize("module", ["typer", "slam.cli.app", "slam.cli.commands.run"])
def test_ctrl_c_while_modules_are_imported_ends_the_command_without_a_word(module: str) -> None:
    command = [sys.executable, "-c", EARLY.format(module=module), "simulate", "office", "--bad"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (130, "", "")

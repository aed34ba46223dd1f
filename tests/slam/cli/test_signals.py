"""Signals that end a command."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

COMPILED = "from numba import njit\n\n@njit(cache=True)\ndef add_one(x):\n    return x + 1\n"
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

from compiled_function import add_one
assert add_one(1) == 2
time.sleep(600)  # ends when the signal is handled again
print("not interrupted")
"""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory with a module whose function another process has compiled."""
    directory = tmp_path_factory.mktemp("compiled")
    (directory / "compiled_function.py").write_text(COMPILED)
    compile_it = "import compiled_function; compiled_function.add_one(1)"
    subprocess.run([sys.executable, "-c", compile_it], cwd=directory, timeout=120, check=True)
    return directory


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_a_function_is_loaded_ends_the_command(compiled: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-c", PROGRAM.format(number=int(number))]
    result = subprocess.run(command, cwd=compiled, capture_output=True, text=True, timeout=120, check=False)
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

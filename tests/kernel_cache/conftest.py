"""Programs that call cached functions, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def run_with_kernel(tmp_path: Path) -> Callable[[str, str], list[str]]:
    """Return a function that runs a program beside a module `toy.kernel`, and returns the words that it prints.

    Its arguments are the text of the module and that of the program, which gets the folder of `toy` as its argument.
    All programs of a test have one cache.
    """
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "__init__.py").touch()

    def run_program(kernel: str, program: str) -> list[str]:
        file = tmp_path / "toy" / "kernel.py"
        if not file.exists():  # with another time, the cached functions would be compiled again
            file.write_text(kernel)
        environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
        command = [sys.executable, "-c", program, str(tmp_path)]
        answer = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=250)
        return answer.stdout.split()

    return run_program

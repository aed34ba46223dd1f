"""Functions that are loaded from a cache take little memory, and others that call them can still be compiled."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kernel_cache.intermediate_code import parse_when_needed

KERNEL = """
from kernel_cache import compile_cached

@compile_cached
def double(x):
    return 2.0 * x
"""

CALL = """
import sys
sys.path.insert(0, sys.argv[1])
from toy.kernel import double

print(double(1.5), sum(double.stats.cache_hits.values()))
(library,) = [result.library for result in double.overloads.values()]
"""

COMPILE = (
    CALL
    + """
from numba import njit

@njit
def quadruple(x):
    return double(double(x))

print(library._shared_module is None, quadruple(1.5), quadruple(2.5), library._shared_module is None)
"""
)


@pytest.fixture
def run(tmp_path: Path):  # type: ignore[no-untyped-def]
    """Return a function that runs a program which calls a cached function, and returns the words that it prints."""
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "__init__.py").touch()
    (tmp_path / "toy" / "kernel.py").write_text(KERNEL)

    def run_program(program: str) -> list[str]:
        environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
        command = [sys.executable, "-c", program, str(tmp_path)]
        answer = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=250)
        return answer.stdout.split()

    return run_program


def test_bitcode_of_a_loaded_function_is_parsed_if_another_one_is_compiled_with_it(run) -> None:  # type: ignore[no-untyped-def]
    assert run(CALL) == ["3.0", "0"]  # compiled
    assert run(COMPILE) == ["3.0", "1", "True", "6.0", "10.0", "False"]


def test_another_version_of_numba_is_left_as_it_is() -> None:
    parse_when_needed(object())

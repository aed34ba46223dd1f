"""Functions that are only a part of compiled functions: compiled once for all numbers in the code, run by Python."""

from __future__ import annotations

from collections.abc import Callable

import pytest

KERNEL = """
from functools import partial
from kernel_cache import compile_cached

@partial(compile_cached, no_cpython_wrapper=True)
def scaled(x, factor):
    return x * factor + 0.5

@compile_cached
def total(x, factor):
    return scaled(x, 0) + scaled(x, 1) + scaled(x, factor)
"""

CALL = """
import sys
sys.path.insert(0, sys.argv[1])
from toy.kernel import scaled, total

print(scaled(2.0, 3), total(2.0, 3), len(scaled.overloads), scaled(2.0, 3))
"""

COMPILE = """
import sys
sys.path.insert(0, sys.argv[1])
from numba import njit
from toy.kernel import scaled

@njit
def doubled(x):
    return scaled(x, 2)

print(doubled(2.0), sum(scaled.stats.cache_hits.values()), scaled(2.0, 2))
"""


@pytest.mark.slow
def test_python_and_compiled_functions_call_them_also_if_they_are_loaded(
    run_with_kernel: Callable[[str, str], list[str]],
) -> None:
    """By itself numba compiles a function for each number in a call, and lets Python call a null pointer."""
    assert run_with_kernel(KERNEL, CALL) == ["6.5", "9.5", "1", "6.5"]
    assert run_with_kernel(KERNEL, COMPILE) == ["4.5", "1", "4.5"]

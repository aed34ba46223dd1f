"""Functions that are loaded from a cache take little memory, and others that call them can still be compiled."""

from __future__ import annotations

from collections.abc import Callable

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


@pytest.mark.slow
def test_bitcode_of_a_loaded_function_is_parsed_if_another_one_is_compiled_with_it(
    run_with_kernel: Callable[[str, str], list[str]],
) -> None:
    assert run_with_kernel(KERNEL, CALL) == ["3.0", "0"]  # compiled
    assert run_with_kernel(KERNEL, COMPILE) == ["3.0", "1", "True", "6.0", "10.0", "False"]


def test_another_version_of_numba_is_left_as_it_is() -> None:
    parse_when_needed(object())

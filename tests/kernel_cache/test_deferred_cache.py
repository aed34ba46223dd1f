"""The cache of a function is opened when the function is called first, not when its module is imported."""

from __future__ import annotations

from collections.abc import Callable

import pytest

KERNEL = """
from kernel_cache import compile_cached

@compile_cached
def double(x):
    return 2.0 * x

@compile_cached
def triple(x):
    return 3.0 * x
"""

CALL = """
import sys
sys.path.insert(0, sys.argv[1])
from kernel_cache import is_cached
from kernel_cache.deferred_cache import DeferredCache
from toy.kernel import double, triple

print(double(1.5), sum(double.stats.cache_hits.values()), isinstance(double._cache, DeferredCache))
print(isinstance(triple._cache, DeferredCache), is_cached(triple), isinstance(triple._cache, DeferredCache))
"""


@pytest.mark.slow
def test_only_the_caches_of_functions_that_are_called_are_opened(
    run_with_kernel: Callable[[str, str], list[str]],
) -> None:
    assert run_with_kernel(KERNEL, CALL) == ["3.0", "0", "False", "True", "False", "False"]  # compiled
    assert run_with_kernel(KERNEL, CALL) == ["3.0", "1", "False", "True", "False", "False"]  # loaded

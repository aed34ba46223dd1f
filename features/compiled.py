"""Decorators that compile functions with numba: once, cached on disk, with IEEE arithmetic instead of exceptions."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from kernel_cache import compile_cached

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def compiled(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Compile scalar code. Division by zero gives infinity or NaN, which the checks of results reject.

    Without numba's memory runtime (NRT) the functions cannot allocate, and do not count references to arrays: the
    caller holds all of them. Counting them at every view of an array took a third of the time of a scan.
    """
    return compile_cached(function, error_model="numpy", forceinline=True, _nrt=False)


def inlined(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Compile scalar code as `compiled` does, but only as a part of compiled functions: Python runs its source."""
    return compile_cached(function, error_model="numpy", forceinline=True, _nrt=False, no_cpython_wrapper=True)


def vectorised(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Compile sums over rays. Sums may be reordered for vector units; NaN and infinity keep their meaning."""
    return compile_cached(function, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "arcp"}, _nrt=False)

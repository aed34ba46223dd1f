"""Compile functions with numba, and cache the result on disk as long as no source changes on which it depends."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from .deferred_cache import defer_cache
from .inner_functions import run_as_source
from .intermediate_code import parse_when_needed
from .literals import compile_once_for_literals
from .loading import load_without_compiler
from .numba_import import njit
from .sources import discard_stale
from .wheel import add_to_wheel, prepend_wheel_cache, wheel_has

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def compile_cached(function: Callable[Arguments, Result], **options: Any) -> Callable[Arguments, Result]:
    """Return a function that is compiled at its first call with arguments of new types, if it cannot be loaded.

    It is loaded from the installed wheel if that has been built with compiled functions that suit this computer
    (`wheel.py`), else from numba's cache on disk. `options` are those of `numba.njit`; a function with
    `no_cpython_wrapper` is compiled as a part of compiled functions only.
    """
    # without a second entry for callers in C, which would be compiled, and optimised, with each function
    dispatcher: Callable[Arguments, Result] = njit(**options | {"no_cfunc_wrapper": True})(function)
    if hasattr(dispatcher, "stats"):  # unless NUMBA_DISABLE_JIT is set
        compile_once_for_literals(dispatcher)
        if options.get("no_cpython_wrapper"):
            run_as_source(dispatcher)
        defer_cache(dispatcher, _open_cache)
        add_to_wheel(dispatcher)
    return dispatcher


def _open_cache(dispatcher: Any) -> None:
    """Let a function of numba be loaded from its cache on disk, or from the installed wheel, if it is not stale."""
    dispatcher.enable_caching()
    discard_stale(Path(inspect.getfile(dispatcher.py_func)), Path(dispatcher._cache.cache_path))
    parse_when_needed(dispatcher)
    load_without_compiler(dispatcher)
    prepend_wheel_cache(dispatcher)


def is_cached(function: Callable[..., object]) -> bool:
    """Return True if a function need not be compiled any more: it can be loaded, for any types of arguments."""
    stats = getattr(function, "stats", None)  # None if NUMBA_DISABLE_JIT is set
    module = Path(inspect.getfile(inspect.unwrap(function))).stem
    on_disk = stats is None or any(Path(stats.cache_path).glob(f"{module}.{function.__name__}-*.nbi"))
    return on_disk or wheel_has(function)

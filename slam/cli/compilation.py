"""Compilation, with a message if it takes long."""

from __future__ import annotations

import logging
import sys
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from .console import print_if_slow

if TYPE_CHECKING:
    from .compilation_message import CompilationMessage

COMPILING = "compiling, once after an installation or update; takes about a minute"


class _CompiledFunctionsFinder:
    """Finder of no module, which announces compilations just before the first compiled function is imported."""

    @classmethod
    def find_spec(cls, name: str, path: object = None, target: object = None) -> None:
        if name == "kernel_cache.functions":
            sys.meta_path.remove(cls)
            import_module("kernel_cache.numba_import")
            _announce_compilation()


def announce_compilation() -> None:
    """Print a message if this process compiles for long, whatever command it runs; imports nothing yet."""
    logging.getLogger("slam.preprocessing.extraction").setLevel(logging.ERROR)  # its warning is for programs
    if "kernel_cache.functions" in sys.modules:
        _announce_compilation()
    else:
        sys.meta_path.insert(0, _CompiledFunctionsFinder)


@cache
def compile_all() -> None:
    """Compile everything that a run calls, or load it from disk; once in a process."""
    from ..preprocessing.extraction import is_compiled
    from ..warmup import warm_up

    if is_compiled():
        warm_up()
    else:
        _announce_compilation().leave_out()
        with print_if_slow(COMPILING):  # the first time, other processes compile too
            warm_up()


def compile_for_recording() -> None:
    """Compile everything if nothing is on disk yet.

    Otherwise a function is loaded from disk, or compiled, when it is called first: no measurement of a recording has
    to wait for that, and functions that it does not need are not loaded.
    """
    from ..preprocessing.extraction import is_compiled

    if not is_compiled():
        compile_all()


@cache
def _announce_compilation() -> CompilationMessage:
    """Print a message if this process compiles for long, from now on."""
    from numba.core.event import register

    from .compilation_message import CompilationMessage

    message = CompilationMessage(COMPILING)
    register("numba:compile", message)  # type: ignore[no-untyped-call]
    return message

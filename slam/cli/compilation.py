"""Compilation for a run, with a message if it takes long."""

from __future__ import annotations

from functools import cache

from .console import print_if_slow

COMPILING = "compiling, once after an installation or update; takes about a minute"


@cache
def compile_all() -> None:
    """Compile everything that a run calls, or load it from disk; once in a process."""
    from ..preprocessing.extraction import is_compiled
    from ..warmup import warm_up

    if is_compiled():
        _announce_compilation()
        warm_up()
    else:
        with print_if_slow(COMPILING):  # the first time, other processes compile too
            warm_up()


def compile_for_recording() -> None:
    """Compile everything if nothing is on disk yet.

    Otherwise a function is loaded from disk, or compiled, when it is called first: no measurement of a recording has
    to wait for that, and functions that it does not need are not loaded.
    """
    from ..preprocessing.extraction import is_compiled

    if is_compiled():
        _announce_compilation()
    else:
        compile_all()


@cache
def _announce_compilation() -> None:
    """Print a message if this process compiles for long, from now on."""
    from numba.core.event import register

    from .compilation_message import CompilationMessage

    register("numba:compile", CompilationMessage(COMPILING))  # type: ignore[no-untyped-call]

"""Compilation before a run, with a message if it takes long."""

from __future__ import annotations

from functools import cache

from .console import print_if_slow

COMPILING = "compiling, once after an installation or update; takes about half a minute"


@cache
def compile_all() -> None:
    """Compile everything that a run calls, or load it from disk; once in a process."""
    from ..warmup import warm_up

    with print_if_slow(COMPILING):
        warm_up()

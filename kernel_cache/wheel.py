"""Compiled functions in the installed wheel.

A wheel for one platform contains functions compiled for a portable level of its processors, such as x86-64-v3, in the
format of numba's own cache. They are used if numba is of the version that compiled them, the processor has all features
of the level, and the sources are unchanged. Otherwise numba compiles, as without them.

Numba's cache has three obstacles to that: its key contains the name of the host's processor, its folder must be
writable, and of the sources it compares the function's own only. So the files here have keys without the processor, are
only read, and are stamped with the hash of all sources on which a function depends.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding

FOLDER = Path(__file__).parent / "compiled"
"""Folder of the compiled functions in an installed wheel; it does not exist in the repository."""

TARGET = "target.json"
"""File in it that states what they were compiled with and for."""

_options: Any = numba.config  # its attributes are set when it is imported

_prepared: list[Any] = []
"""All functions of this process that may be written to a wheel."""


def add_to_wheel(dispatcher: Any) -> None:
    """Let `write_wheel_cache` write a function of numba."""
    _prepared.append(dispatcher)


def prepend_wheel_cache(dispatcher: Any) -> None:
    """Let a function of numba be loaded from the installed wheel, if that suits this computer."""
    if _suits_this_computer():
        from .wheel_cache import WheelCache

        dispatcher._cache = WheelCache(dispatcher, FOLDER)


def wheel_has(function: Callable[..., object]) -> bool:
    """Return True if a function of numba can be loaded from the installed wheel, for any types of arguments."""
    if not _suits_this_computer():
        return False
    from .wheel_cache import WheelCache

    cache = getattr(function, "_cache", None)
    return isinstance(cache, WheelCache) and cache.contains_any()


def write_wheel_cache(folder: Path, features: Iterable[str]) -> int:
    """Copy all functions of this process from numba's cache to a folder, which becomes FOLDER of a wheel.

    The cache must have been empty, and numba must run with NUMBA_CPU_NAME and NUMBA_CPU_FEATURES, for a processor that
    has `features` (names of LLVM) and no others. Returns how many functions there are.
    """
    from .wheel_cache import write_functions

    count = write_functions(_prepared, folder)
    target = {"numba": numba.__version__, "features": sorted(features)}
    (folder / TARGET).write_text(json.dumps(target) + "\n", encoding="utf-8")
    return count


@cache
def _suits_this_computer() -> bool:
    """Return True if there are functions in the wheel that numba's version and the processor can run."""
    try:
        target = json.loads((FOLDER / TARGET).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return False
    if target["numba"] != numba.__version__ or _options.CPU_NAME is not None:
        return False  # or the user wants functions for another processor
    return set(target["features"]) <= _host_features()


def _host_features() -> set[str]:
    """Return the features of the processor, without those that the user has switched off in numba."""
    if _options.CPU_FEATURES is not None:
        return {feature[1:] for feature in _options.CPU_FEATURES.split(",") if feature.startswith("+")}
    try:
        return {feature for feature, present in binding.get_host_cpu_features().items() if present}
    except RuntimeError:  # LLVM does not know this processor
        return set()

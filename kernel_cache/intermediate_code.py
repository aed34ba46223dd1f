"""Intermediate code (LLVM's bitcode) of loaded functions, and its memory.

Numba stores a function as machine code and as bitcode, and parses the latter when it loads the function. It is needed
only if another function is compiled that calls this one, but takes twenty times the memory of the machine code: 30 MB
in a run of SLAM. So it is freed here after loading, and parsed again if a function is compiled after all.
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import Any

from llvmlite import binding


def free_when_loaded(dispatcher: Any) -> None:
    """Free the parsed bitcode of a function of numba each time that it is loaded from a cache on disk.

    No effect with a version of numba that loads functions in another way.
    """
    with suppress(AttributeError):
        loader = dispatcher._cache._impl
        loader.rebuild = partial(_rebuild, loader.rebuild)


def _rebuild(rebuild: Any, context: Any, stored: Any) -> Any:
    """Return the compiled function that `rebuild` makes of what is stored, without parsed bitcode."""
    result = rebuild(context, stored)
    with suppress(AttributeError, TypeError, ValueError, IndexError):
        _, kind, (_, bitcode) = stored[0]
        if kind == "object" and result.library._shared_module is not None:
            result.library._shared_module = None
            result.library._get_module_for_linking = partial(_parsed, result.library, bitcode)
    return result


def _parsed(library: Any, bitcode: bytes) -> Any:
    """Return the bitcode of a library for linking, parsed at the first call."""
    if library._shared_module is None:
        library._shared_module = binding.parse_bitcode(bitcode)
    return library._shared_module

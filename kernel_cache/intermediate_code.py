"""Intermediate code (LLVM's bitcode) of loaded functions, which is parsed only when it is needed.

Numba stores a function as machine code and as bitcode, and parses the latter when it loads the function. It is needed
only if another function is compiled that calls this one, but takes twenty times the memory of the machine code, 30 MB
in a run of SLAM, and half the time of loading. So numba is given an empty module to parse instead, and the bitcode is
parsed if a function is compiled after all.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cache, partial
from typing import Any

from llvmlite import binding


def parse_when_needed(dispatcher: Any) -> None:
    """Parse the bitcode of a function of numba that is loaded from a cache on disk only when it is linked.

    No effect with a version of numba that loads functions in another way.
    """
    with suppress(AttributeError):
        loader = dispatcher._cache._impl
        loader.rebuild = partial(_rebuild, loader.rebuild, dispatcher.targetoptions)


def _rebuild(rebuild: Any, options: Any, context: Any, stored: Any) -> Any:
    """Return the compiled function that `rebuild` makes of what is stored, without parsing its bitcode.

    `options` are those with which the function was compiled.
    """
    try:
        (name, kind, (code, bitcode)), described, *others = stored
        symbols = context.codegen()._engine._defined_symbols
        entries = {described.llvm_func_name}
        if not options.get("no_cpython_wrapper"):
            entries.add(described.llvm_cpython_wrapper_name)
    except (AttributeError, TypeError, ValueError):  # another version of numba
        return rebuild(context, stored)
    if kind != "object":
        return rebuild(context, stored)
    symbols.update(entries)  # numba takes them from the bitcode
    result = rebuild(context, ((name, kind, (code, _empty_module())), described, *others))
    result.library._shared_module = None
    result.library._get_module_for_linking = partial(_parsed, result.library, bitcode)
    return result


@cache
def _empty_module() -> bytes:
    """Return the bitcode of a module without functions."""
    bitcode: bytes = binding.parse_assembly("").as_bitcode()
    return bitcode


def _parsed(library: Any, bitcode: bytes) -> Any:
    """Return the bitcode of a library for linking, parsed at the first call."""
    if library._shared_module is None:
        library._shared_module = binding.parse_bitcode(bitcode)
    return library._shared_module

"""Decorators that compile functions with numba, once."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from typing import ParamSpec, TypeVar

from kernel_cache import compile_cached

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def _import_array_functions() -> None:
    """Import numba's functions of arrays without SciPy's linear algebra.

    Before the first compiled function runs, numba imports both to find out if there is BLAS. That takes a sixth of a
    second and 16 MB, and no function of this project calls it: products of small matrices are written out. A function
    of another program that calls BLAS imports it when it is compiled.
    """
    if "scipy.linalg" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # an import of it fails
    try:
        with suppress(ImportError):  # another version of numba: it imports SciPy when it needs it
            from numba.np import arraymath

            arraymath._HAVE_BLAS = True  # it can be imported from now on
    finally:
        del sys.modules["scipy.linalg"]


_import_array_functions()


def compiled(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Compile a function at its first call, or load it from disk."""
    return compile_cached(function)


def inlined(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Compile a function that compiled functions call in inner loops, and put its code in place of each call.

    To pass arrays to a function takes as long as some dozens of operations. LLVM itself inlines only the smallest ones.
    The function must not create arrays: it is compiled without the counts of references to them, whose updates, atomic
    operations, would take longer than the rest of many a function. It is compiled as a part of them only: Python runs
    its source.
    """
    return compile_cached(function, forceinline=True, _nrt=False, no_cpython_wrapper=True)

"""Functions that are compiled as a part of other compiled functions only.

Most functions of an inner loop are called by compiled functions and never by Python. Without an entry for Python, which
contains the function once more, a tenth of the time of compilation is saved. Numba would call a null pointer where that
entry should be, so Python runs the source of such a function: tests call some of them.
"""

from __future__ import annotations

from typing import Any


def run_as_source(dispatcher: Any) -> None:
    """Let Python run the source of a function of numba that has been compiled with `no_cpython_wrapper`."""

    def add_overload(compiled: Any) -> None:
        """Keep a compiled function for compiled callers, but no entry for Python."""
        dispatcher.overloads[tuple(compiled.signature.args)] = compiled

    dispatcher.add_overload = add_overload
    dispatcher._compile_for_args = lambda *arguments, **named: dispatcher.py_func

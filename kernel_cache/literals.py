"""Calls of compiled functions with numbers that are written in the code.

For numba the type of a number in the code includes its value: a function that is called with 0, with 1 and with a
variable would be compiled three times. Here the type of such a number is that of a variable.
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import Any


def compile_once_for_literals(dispatcher: Any) -> None:
    """Compile a function of numba once for all values of numbers in the code of its callers.

    No effect with a version of numba that resolves calls in another way.
    """
    with suppress(AttributeError):
        dispatcher.get_call_template = partial(_call_template, dispatcher.get_call_template)


def _call_template(get_call_template: Any, arguments: Any, named: Any) -> Any:
    """Return what numba needs for a call with arguments of given types."""
    from numba.core.types import unliteral

    return get_call_template(tuple(map(unliteral, arguments)), {name: unliteral(kind) for name, kind in named.items()})

"""Loading of functions from numba's cache without what numba needs only to compile.

Before it loads a function numba imports all its implementations of Python's and NumPy's functions, as if it had to
compile: that takes a sixth of a second and some megabytes. The compiler imports them itself if it is called after all.
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import Any


def load_without_compiler(dispatcher: Any) -> None:
    """Let a function of numba be loaded from its cache on disk without preparing numba's compiler.

    No effect with a version of numba that loads functions in another way.
    """
    with suppress(AttributeError):
        cache = dispatcher._cache
        cache.load_overload = partial(_load, cache._guard_against_spurious_io_errors, cache._load_overload)


def prepare_runtime(context: Any) -> None:
    """Initialise what loaded functions call: the management of arrays' memory."""
    from numba.core.runtime.nrt import rtsys

    rtsys.initialize(context)


def _load(guard: Any, load: Any, signature: Any, context: Any) -> Any:
    """Return the function that numba's cache has for a signature, or None."""
    prepare_runtime(context)
    with guard():
        return load(signature, context)
    return None  # after an error in reading

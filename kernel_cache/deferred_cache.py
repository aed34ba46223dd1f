"""Cache of a function on disk, which is opened when the function is called or compiled for the first time.

A run of SLAM calls a fifth of all compiled functions. To find the cache of a function, and whether it is stale, takes
half a millisecond.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def defer_cache(dispatcher: Any, open_cache: Callable[[Any], None]) -> None:
    """Let `open_cache` set the cache of a function of numba when it is needed."""
    dispatcher._cache = DeferredCache(dispatcher, open_cache)


class DeferredCache:
    """Stands for the cache of a function, until any attribute of it is used."""

    def __init__(self, dispatcher: Any, open_cache: Callable[[Any], None]) -> None:
        self._dispatcher, self._open_cache = dispatcher, open_cache

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the cache, which takes the place of this object."""
        if self._dispatcher._cache is self:
            self._open_cache(self._dispatcher)
        return getattr(self._dispatcher._cache, name)

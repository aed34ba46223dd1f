"""Cache of numba that first looks into the installed wheel.

All internal interfaces of numba's cache that the project uses are here. From a wheel this module is imported only if
numba is of the version that compiled its functions.
"""

from __future__ import annotations

import inspect
import shutil
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile, _Cache

from .loading import prepare_runtime
from .sources import digest_of, path_in_package


class WheelCache(_Cache):
    """Numba's cache of a function, preceded by the functions in the folder of a wheel, which are only read."""

    def __init__(self, dispatcher: Any, folder: Path) -> None:
        self._cache = dispatcher._cache
        self._delivered = _files_of(dispatcher, folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function for the given types, from the wheel or else from numba's cache, or None."""
        prepare_runtime(target_context)
        data = self._delivered.load(_without_processor(self._cache._index_key(sig, target_context.codegen())))
        if data is None:
            return self._cache.load_overload(sig, target_context)
        return self._cache._impl.rebuild(target_context, data)

    def contains_any(self) -> bool:
        """Return True if the wheel has the function, unchanged, for any types of arguments."""
        return bool(self._delivered._load_index())

    @property
    def cache_path(self) -> str:
        """Folder of numba's cache, where functions are stored that the wheel does not have."""
        return str(self._cache.cache_path)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled function in numba's cache."""
        self._cache.save_overload(sig, data)

    def enable(self) -> None:
        """Enable numba's cache."""
        self._cache.enable()

    def disable(self) -> None:
        """Disable numba's cache."""
        self._cache.disable()

    def flush(self) -> None:
        """Empty numba's cache."""
        self._cache.flush()


def write_functions(dispatchers: list[Any], folder: Path) -> int:
    """Copy what numba's cache has of the dispatchers to the folder of a wheel; return how many functions these are."""
    count = 0
    for dispatcher in dispatchers:
        source, target = dispatcher._cache._cache_file, _files_of(dispatcher, folder)
        names = {_without_processor(key): name for key, name in source._load_index().items()}
        if names:
            Path(target._cache_path).mkdir(parents=True, exist_ok=True)
            target._save_index(names)
        for name in names.values():
            shutil.copyfile(source._data_path(name), target._data_path(name))
        count += len(names)
    return count


def _files_of(dispatcher: Any, folder: Path) -> IndexDataCacheFile:
    """Return the files of a function in the wheel, which are empty if any source on which it depends has changed."""
    source = Path(inspect.getfile(dispatcher.py_func))
    place = folder / path_in_package(source).parent
    return IndexDataCacheFile(str(place), dispatcher._cache._impl.filename_base, _digest_of(source))


@cache
def _digest_of(source: Path) -> str:
    return digest_of(source)


def _without_processor(key: tuple[Any, Any, Any]) -> tuple[Any, Any]:
    """Return numba's key of a compiled function (types, processor, code) without the processor."""
    types, _, code = key
    return types, code

"""Decorators that compile functions with numba: once, cached on disk, with IEEE arithmetic instead of exceptions."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, TypeVar

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


class Decorator(Protocol):
    """Decorator that does not change the type of a function."""

    def __call__(self, function: Function, /) -> Function:
        """Return the function, to be compiled at its first call."""


def discard_stale(package: Path) -> None:
    """Delete the cached functions of a package and its sub-packages if any of its sources has changed.

    Numba compares the file of a cached function only, but it also compiles in constants and functions of other files.
    Without write access nothing is deleted: such a package is not being edited.
    """
    stats = [(source.relative_to(package).as_posix(), source.stat()) for source in sorted(package.rglob("*.py"))]
    stamp = hashlib.sha256(repr([(name, s.st_mtime_ns, s.st_size) for name, s in stats]).encode()).hexdigest()[:16]
    cache = package / "__pycache__"
    mark = cache / f"sources-{stamp}"
    if mark.exists():
        return
    with suppress(OSError):
        for pattern in ("sources-*", "*.nbi", "*.nbc"):
            for old in package.rglob(f"__pycache__/{pattern}"):
                old.unlink(missing_ok=True)
        cache.mkdir(exist_ok=True)
        mark.touch()


discard_stale(Path(__file__).parent)

compiled: Decorator = njit(  # type: ignore[call-overload]  # numba's stubs leave _nrt out
    cache=True, error_model="numpy", forceinline=True, _nrt=False
)
"""Decorator for scalar code. Division by zero gives infinity or NaN, which the checks of results reject.

Without numba's memory runtime (NRT) the functions cannot allocate, and do not count references to arrays: the caller
holds all of them. Counting them at every view of an array took a third of the time of a scan.
"""

vectorised: Decorator = njit(  # type: ignore[call-overload]
    cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "arcp"}, _nrt=False
)
"""Decorator for sums over rays. Sums may be reordered for vector units; NaN and infinity keep their meaning."""

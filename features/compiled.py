"""How the inner loops are compiled: once, kept on disk, and with IEEE arithmetic instead of exceptions."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, TypeVar

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


class Decorator(Protocol):
    """What leaves the type of a function as it is."""

    def __call__(self, function: Function, /) -> Function:
        """The same, compiled at its first call."""


def discard_stale(package: Path) -> None:
    """Delete the compiled functions in the package's cache if any source of the package changed since.

    Numba checks the file of the cached function only, while the functions here are compiled into their callers in
    other files. Without write access nothing is deleted: such a package is not being edited.
    """
    stats = [(source.name, source.stat()) for source in sorted(package.glob("*.py"))]
    stamp = hashlib.sha256(repr([(name, s.st_mtime_ns, s.st_size) for name, s in stats]).encode()).hexdigest()[:16]
    cache = package / "__pycache__"
    mark = cache / f"sources-{stamp}"
    if mark.exists():
        return
    with suppress(OSError):
        for old in [*cache.glob("sources-*"), *cache.glob("*.nbi"), *cache.glob("*.nbc")]:
            old.unlink(missing_ok=True)
        cache.mkdir(exist_ok=True)
        mark.touch()


discard_stale(Path(__file__).parent)

compiled: Decorator = njit(  # type: ignore[call-overload]  # numba's stubs leave _nrt out
    cache=True, error_model="numpy", forceinline=True, _nrt=False
)
"""Division by zero gives infinity or NaN, which the tests on results reject.

Without numba's run time for memory (NRT) they cannot allocate, and count no references to arrays: the caller holds them
all. To count, at every view of an array, took a third of the time of a scan.
"""

vectorised: Decorator = njit(  # type: ignore[call-overload]
    cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "arcp"}, _nrt=False
)
"""For sums over rays. They may be reordered, so that they run on vector units; NaN and infinity keep their meaning."""

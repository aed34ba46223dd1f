"""How the inner loops are compiled: once, kept on disk, and with IEEE arithmetic instead of exceptions."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

from numba import njit


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

compiled = njit(cache=True, error_model="numpy", forceinline=True)
"""Division by zero gives infinity or NaN, which the tests on results reject."""

vectorised = njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "arcp"})
"""For sums over rays. They may be reordered, so that they run on vector units; NaN and infinity keep their meaning."""

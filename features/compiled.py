"""How the inner loops are compiled: once, kept on disk, and with IEEE arithmetic instead of exceptions."""

from __future__ import annotations

from numba import njit

compiled = njit(cache=True, error_model="numpy", forceinline=True)
"""Division by zero gives infinity or NaN, which the tests on results reject."""

vectorised = njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "arcp"})
"""For sums over rays. They may be reordered, so that they run on vector units; NaN and infinity keep their meaning."""

"""Import of numba without the tool that measures the coverage of tests.

Numba imports `coverage` if it is installed, as where the project is developed. That takes 0.07 s and 6 MB.
"""

import sys

if "numba" in sys.modules or "coverage" in sys.modules:
    from numba import njit
else:
    sys.modules["coverage"] = None  # type: ignore[assignment]  # an import of it fails
    try:
        from numba import njit
    finally:
        del sys.modules["coverage"]

__all__ = ["njit"]

"""Import of Arrow, with which the review log is written, without pandas.

With the first array that it makes, Arrow imports pandas if it is installed: 0.4 s and 50 MB, for nothing. Afterwards it
treats pandas as not installed, so only commands do this: the process of a user of the package may use both.
"""

from __future__ import annotations

import sys


class _PandasMissing:
    """Finder of modules that states of pandas that it is not installed.

    None in `sys.modules` would not do: Arrow's compiled import takes it for the module.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        if name == "pandas":
            raise ModuleNotFoundError(name)


def import_arrow() -> None:
    """Import Arrow and let it do without pandas; no effect if pandas is imported already."""
    if "pandas" in sys.modules:
        return
    import pyarrow as pa

    sys.meta_path.insert(0, _PandasMissing)
    try:
        pa.array([])
    finally:
        sys.meta_path.remove(_PandasMissing)

"""Replace a function or class for a test, also in modules that are imported meanwhile."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


@contextmanager
def replaced(module: ModuleType, name: str, replacement: object) -> Iterator[None]:
    """Replace the attribute `name` of a module, and restore it everywhere at the end.

    A module that is imported in between with `from module import name` would keep the replacement for all later tests
    of the process.
    """
    real = getattr(module, name)
    setattr(module, name, replacement)
    try:
        yield
    finally:
        for imported in list(sys.modules.values()):
            if getattr(imported, "__dict__", {}).get(name) is replacement:
                setattr(imported, name, real)

"""Optional dependencies: packages that belong to an extra of the distribution and are imported when needed."""

from __future__ import annotations

from importlib.util import find_spec

from .errors import MissingExtraError

EXTRAS = {
    "batch": ("dask", "distributed", "cloudpickle"),
    "plans": ("ezdxf", "PIL"),
    "plots": ("matplotlib",),
    "web": ("tornado",),
}
"""Packages by extra."""


def require_extra(extra: str) -> None:
    """Raise MissingExtraError if a package of an extra is not installed. Imports nothing."""
    for package in EXTRAS[extra]:
        if find_spec(package) is None:
            raise MissingExtraError(extra, package)

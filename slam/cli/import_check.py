"""Check that `drivers` and `features` are the packages of this distribution.

Their names are common: a folder of that name in the current directory or in PYTHONPATH would be imported instead.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("drivers", "features")
"""Top-level packages that are installed beside `slam`."""


def find_import_error() -> str | None:
    """Return an error message if one of PACKAGES would be imported from elsewhere; imports nothing."""
    root = Path(__file__).resolve().parents[2]
    for name in PACKAGES:
        expected = root / name / "__init__.py"
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            return f"{expected}: missing; install wclm-slam again"
        if Path(spec.origin).resolve() != expected:
            return (
                f"{spec.origin}: is imported as `{name}` instead of {expected}; "
                "rename it, change the directory, or correct PYTHONPATH"
            )
    return None

"""Check of arguments of public functions, so that one of a wrong type is named in one line where it is given."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from .errors import ArgumentError


def check_type(name: str, value: object, kind: type, expected: str) -> None:
    """Raise ArgumentError if an argument is not of a type; `expected` says what it must be, with its article."""
    if not isinstance(value, kind):
        raise ArgumentError(f"{name} must be {expected}, not {type(value).__name__}")


def check_items(name: str, values: object, kind: type, expected: str) -> None:
    """Raise ArgumentError if an argument is not a list, or one of its items not of a type; a text is no list."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise ArgumentError(f"{name} must be a list of {expected}, not {type(values).__name__}")
    for value in values if isinstance(values, Sequence) else ():  # others may be read once only
        check_type(f"each of {name}", value, kind, expected)


def path_of(name: str, value: str | os.PathLike[str]) -> Path:
    """Return an argument that names a file or a directory as a path. Raises ArgumentError if it is none."""
    if not isinstance(value, str | os.PathLike):
        raise ArgumentError(f"{name} must be the name of a file or directory, not {type(value).__name__}")
    return Path(value)

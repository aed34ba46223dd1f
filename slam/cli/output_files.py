"""Directories and text files that commands write, with errors that name the path."""

from __future__ import annotations

from pathlib import Path

from ..errors import OutputError


def make_directory(out: Path) -> None:
    """Create a directory and its parents if missing. Raises OutputError if that fails."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be created: {error.strerror or error}") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file with a newline at its end. Raises OutputError if that fails."""
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error

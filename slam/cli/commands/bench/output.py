"""What the results of all benchmarks state, and how they are written."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from ....errors import OutputError
from ....io.host import machine, versions


def provenance(seed: int) -> dict[str, Any]:
    """The machine, the versions and the seed, for JSON."""
    return {"machine": machine(), "versions": versions(), "seed": seed}


def heading(seed: int) -> list[str]:
    """The same in lines of text."""
    return [
        "; ".join(f"{name}: {value}" for name, value in machine().items()),
        ", ".join(f"{name} {version}" for name, version in versions().items()) + f"; seed {seed}",
    ]


def plain(rows: Iterable[NamedTuple]) -> list[dict[str, Any]]:
    """Rows for JSON, which knows no NaN: null."""
    return [
        {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in row._asdict().items()
        }
        for row in rows
    ]


def make_directory(out: Path) -> None:
    """Make a directory for results. Raises OutputError where that cannot be."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be made: {error.strerror or error}") from error


def write(path: Path, text: str) -> None:
    """Write a text file. Raises OutputError where that cannot be."""
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error

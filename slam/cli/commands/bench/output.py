"""Options and result headers that benchmarks share."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from ....io.host import describe_machine, versions
from ....io.output_dir import to_json_types

JsonOption = Annotated[bool, typer.Option("--json", help="Print one line of JSON instead of text.")]
JsonFileOption = Annotated[Path | None, typer.Option("--json", metavar="FILE.json", help="JSON file for all figures.")]
TablesOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Output directory for tables and pictures.")
]


def provenance(seed: int) -> dict[str, Any]:
    """Return the machine, the versions and the seed, for JSON."""
    return {"machine": describe_machine(), "versions": versions(), "seed": seed}


def heading(seed: int) -> list[str]:
    """Return the machine, the versions and the seed as lines of text."""
    return [
        "; ".join(f"{name}: {value}" for name, value in describe_machine().items()),
        ", ".join(f"{name} {version}" for name, version in versions().items()) + f"; seed {seed}",
    ]


def plain_rows(rows: Iterable[NamedTuple]) -> list[dict[str, Any]]:
    """Return rows as plain data for JSON, with null for NaN."""
    return [to_json_types(row._asdict()) for row in rows]

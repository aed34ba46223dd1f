"""Options and result headers that benchmarks share."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from ....errors import ConfigurationError

JsonOption = Annotated[bool, typer.Option("--json", help="Print one line of JSON instead of text.")]
JsonFileOption = Annotated[Path | None, typer.Option("--json", metavar="FILE.json", help="JSON file for all figures.")]
TablesOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Output directory for tables and pictures.")
]
FirstSeedOption = Annotated[int, typer.Option("--first-seed", min=0, help="Seed of the first drive.")]
DurationOption = Annotated[
    float | None, typer.Option("--duration", min=1.0, help="Duration of each drive in seconds; by default all.")
]


def condition_option(names: str) -> Any:
    """Return the option that chooses some conditions, of which all `names` are listed in its help."""
    return typer.Option("--condition", metavar="NAME", help=f"Condition, can be repeated; by default all: {names}.")


def check_conditions(names: Iterable[str] | None, known: Collection[str], kind: str = "condition") -> tuple[str, ...]:
    """Return the chosen conditions, each once, or all `known` ones. Raises ConfigurationError for an unknown name.

    kind  of what is chosen, also the name of the option
    """
    chosen = tuple(dict.fromkeys(names or known))
    if unknown := [name for name in chosen if name not in known]:
        raise ConfigurationError(f"--{kind} {unknown[0]}: no such {kind}; known are {', '.join(known)}")
    return chosen


def provenance(seed: int | None) -> dict[str, Any]:
    """Return the machine, the versions and the seed, if there is one, for JSON."""
    from ....io.host import describe_machine, versions

    content: dict[str, Any] = {"machine": describe_machine(), "versions": versions()}
    return content if seed is None else content | {"seed": seed}


def heading(seed: int) -> list[str]:
    """Return the machine, the versions and the seed as lines of text."""
    from ....io.host import describe_machine, versions

    return [
        "; ".join(f"{name}: {value}" for name, value in describe_machine().items()),
        ", ".join(f"{name} {version}" for name, version in versions().items()) + f"; seed {seed}",
    ]


def plain_rows(rows: Iterable[NamedTuple]) -> list[dict[str, Any]]:
    """Return rows as plain data for JSON, with null for NaN."""
    from ....io.json_files import to_json_types

    return [to_json_types(row._asdict()) for row in rows]

"""`wclm bench measure`: errors of measurements compared with their standard deviations."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from ...compilation import compile_all
from ...console import progress
from .output import DurationOption, FirstSeedOption, JsonOption, heading, provenance


def bench_measure(
    world: Annotated[str, typer.Option("--world", metavar="NAME", help="Built-in world, or a TOML file.")] = "office",
    first_seed: FirstSeedOption = 0,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Number of drives, each with its own noise.")] = 20,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare measurements of simulated drives with the truth: 95 % should be within 1.96 standard deviations.

    Example: [bold]wclm bench measure --seeds 20 --duration 100[/bold]
    """
    from ....evaluation.benchmarks.measuring import coverage, coverage_table, measure_drives
    from ....io.json_files import to_json_types

    compile_all()
    drives = measure_drives(range(first_seed, first_seed + seeds), world, duration)
    rows = coverage(list(progress(drives, seeds, world)))
    if as_json:
        content = provenance(first_seed) | {"seeds": seeds, "rows": [to_json_types(asdict(row)) for row in rows]}
        typer.echo(json.dumps(content))
    else:
        typer.echo("\n".join([*heading(first_seed), *coverage_table(rows)]))

"""`wclm bench regular`: right angles and parallels that are imposed on maps, compared with the building."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Annotated

import typer

from ...compilation import compile_all
from ...console import progress
from .output import DurationOption, FirstSeedOption, JsonOption, heading, provenance


def bench_regular(
    world: Annotated[str, typer.Option("--world", metavar="NAME", help="Built-in world, or a TOML file.")] = "office",
    skews: Annotated[
        list[float] | None,
        typer.Option(
            "--skew",
            metavar="DEGREES",
            min=0.0,
            max=10.0,
            help="Angle by which some walls are turned, can be repeated; by default 0 and 1.",
        ),
    ] = None,
    first_seed: FirstSeedOption = 0,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Number of drives for each angle.")] = 10,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Impose right angles and parallels on maps of simulated drives, with walls that are skewed.

    Example: [bold]wclm bench regular --skew 1 --seeds 10 --duration 100[/bold]
    """
    from ....evaluation.benchmarks.regularity import regularise_drives, regularity_table
    from ....io.json_files import to_json_types

    compile_all()
    numbers, rows = range(first_seed, first_seed + seeds), []
    for degrees in skews or (0.0, 1.0):
        drives = regularise_drives(numbers, world, duration, math.radians(degrees))
        rows.append((math.radians(degrees), list(progress(drives, seeds, f"{world}, {degrees:g} degrees"))))
    if as_json:
        content = [{"skew": skew, "drives": [to_json_types(asdict(one)) for one in drives]} for skew, drives in rows]
        typer.echo(json.dumps(provenance(first_seed) | {"seeds": seeds, "rows": content}))
    else:
        typer.echo("\n".join([*heading(first_seed), *regularity_table(rows)]))

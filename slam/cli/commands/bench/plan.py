"""`wclm bench plan`: simulated drives that are mapped with a plan, right or wrong."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from ...compilation import compile_all
from ...console import progress
from .output import DurationOption, FirstSeedOption, JsonOption, check_conditions, condition_option, heading, provenance

NAMES = "right, wrong-walls, large-loop"


def bench_plan(
    conditions: Annotated[list[str] | None, condition_option(NAMES)] = None,
    first_seed: FirstSeedOption = 0,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Number of drives per condition.")] = 5,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Map simulated drives with a plan, right or wrong, from an unknown start, and compare with the truth.

    Example: [bold]wclm bench plan --condition wrong-walls --seeds 10[/bold]
    """
    from ....evaluation.benchmarks.plans import CONDITIONS, map_with_plans, plans_table
    from ....io.json_files import to_json_types

    chosen = check_conditions(conditions, CONDITIONS)
    compile_all()
    numbers, results = range(first_seed, first_seed + seeds), {}
    for name in chosen:
        results[name] = list(progress(map_with_plans(name, numbers, duration), seeds, name))
    if as_json:
        rows = {name: [to_json_types(asdict(drive)) for drive in drives] for name, drives in results.items()}
        typer.echo(json.dumps(provenance(first_seed) | {"seeds": seeds, "conditions": rows}))
    else:
        typer.echo("\n".join([*heading(first_seed), *plans_table(results)]))

"""`wclm bench diff`: changes between simulated drives that are found, and false discoveries."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from ...compilation import compile_all
from ...console import progress
from .output import JsonOption, check_conditions, condition_option, heading, provenance

NAMES = (
    "unchanged, moved-2cm, moved-5cm, moved-10cm, moved-20cm, added, closed-doors, shifted-5cm, shifted-10cm, "
    "shifted-20cm"
)


def bench_diff(
    conditions: Annotated[list[str] | None, condition_option(NAMES)] = None,
    first_seed: Annotated[int, typer.Option("--first-seed", min=0, help="Seed of the first pair.")] = 0,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Number of pairs of drives per condition.")] = 3,
    duration: Annotated[float, typer.Option("--duration", min=1.0, help="Duration of each drive in seconds.")] = 100.0,
    false_discovery_rate: Annotated[
        float, typer.Option("--fdr", min=1e-9, max=0.5, help="Accepted false-discovery rate.")
    ] = 0.05,
    as_json: JsonOption = False,
) -> None:
    """Compare maps of pairs of simulated drives through an office that has changed in between.

    Each pair takes about twenty seconds.

    Example: [bold]wclm bench diff --condition unchanged --seeds 20[/bold]
    """
    from ....evaluation.benchmarks.map_changes import CONDITIONS, changes_table, compare_pairs

    chosen = check_conditions(conditions, CONDITIONS)
    compile_all()
    numbers, results = range(first_seed, first_seed + seeds), {}
    for name in chosen:
        pairs = compare_pairs(name, numbers, duration, false_discovery_rate)
        results[name] = list(progress(pairs, seeds, name))
    if as_json:
        rows = {name: [asdict(pair) for pair in pairs] for name, pairs in results.items()}
        typer.echo(json.dumps(provenance(first_seed) | {"seeds": seeds, "conditions": rows}))
    else:
        typer.echo("\n".join([*heading(first_seed), *changes_table(results)]))

"""`wclm bench consistency`: errors compared with covariances."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from ...compilation import compile_all
from ...console import print_message, progress
from .output import FirstSeedOption, JsonOption, check_conditions, condition_option, heading, provenance

NAMES = (
    "nominal, range-noise-5mm, range-noise-3cm, half-circle, range-bias, bent-walls, spin-2hz, bad-wheels, "
    "bearing-noise, outliers, late-scans, inexact-stamps, corridor, columns, boxes, buildings, "
    "worn-buildings, sparse-buildings"
)


def bench_consistency(
    conditions: Annotated[list[str] | None, condition_option(NAMES)] = None,
    first_seed: FirstSeedOption = 0,
    seeds: Annotated[
        int, typer.Option("--seeds", "--runs", min=1, help="Number of drives per condition, each with its own noise.")
    ] = 5,
    duration: Annotated[float, typer.Option("--duration", min=1.0, help="Duration of each drive in seconds.")] = 60.0,
    range_bias: Annotated[
        float, typer.Option("--range-bias", min=-0.5, max=0.5, help="Range bias in metres, added in each condition.")
    ] = 0.0,
    calibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="Estimate the range bias from an additional drive, as `wclm calibrate` does."),
    ] = False,
    processes: Annotated[int, typer.Option("--processes", min=1, help="Number of processes.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Compare errors with covariances on simulated drives (NEES) under several conditions.

    A NEES of 1 is consistent, more is overconfident. The lidar is mounted off-centre and turned by 100 degrees. Each
    drive takes about three seconds. Each condition has a row with the means over its drives and their standard errors;
    means outside of 0.7 to 1.4 have a question mark, those that are more than two standard errors outside are bold.

    Example: [bold]wclm bench consistency --condition nominal --condition bent-walls --seeds 20[/bold]
    """
    from ....config import Config
    from ....evaluation.benchmarks.consistency import calibrated_config, consistency_table, simulate, summarise
    from ....evaluation.benchmarks.consistency_conditions import CONDITIONS

    chosen = check_conditions(conditions, CONDITIONS)
    compile_all()
    config = Config()
    if calibrate:
        config, sigma = calibrated_config(range_bias, duration)
        print_message(f"estimated range bias {config.lidar.range_bias:.4f} ± {sigma:.4f} m")
    numbers, results = range(first_seed, first_seed + seeds), []
    for name in chosen:
        drives = simulate(numbers, duration, name, range_bias=range_bias, config=config, processes=processes)
        results.append(summarise(list(progress(drives, seeds, name)), name))
    if as_json:
        content = provenance(first_seed) | {"seeds": seeds, "conditions": [result.as_data() for result in results]}
        typer.echo(json.dumps(content))
    else:
        typer.echo("\n".join([*heading(first_seed), *consistency_table(results)]))

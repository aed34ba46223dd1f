"""`wclm bench consistency`: errors compared with covariances."""

from __future__ import annotations

from typing import Annotated

import typer

from ...console import progress
from .output import heading


def bench_consistency(
    runs: Annotated[
        int, typer.Option("--runs", min=1, help="Number of simulated drives, each with its own noise.")
    ] = 100,
    duration: Annotated[float, typer.Option("--duration", help="Duration of each drive in seconds.")] = 60.0,
    range_bias: Annotated[
        float, typer.Option("--range-bias", min=-0.5, max=0.5, help="Simulated range bias in metres.")
    ] = 0.0,
    calibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="Estimate the range bias from an additional drive, as `wclm calibrate` does."),
    ] = False,
) -> None:
    """Compare errors with covariances on simulated drives (NEES).

    A NEES of 1 is consistent, more is overconfident. The lidar is mounted off-centre and turned by 100 degrees. Each
    drive takes about two seconds.

    Example: [bold]wclm bench consistency --runs 20[/bold]
    """
    from ....config import Config
    from ....evaluation.benchmarks.consistency import calibrated_config, consistency_table, simulate, summarise

    config = Config()
    typer.echo("\n".join(heading(0)))
    if calibrate:
        config, sigma = calibrated_config(range_bias, duration)
        typer.echo(f"range bias  {config.lidar.range_bias:.4f} ± {sigma:.4f} m, estimated")
    drives = simulate(range(runs), duration, range_bias=range_bias, config=config)
    found = list(progress(drives, runs, "drives"))
    typer.echo("\n".join(consistency_table(summarise(found))))

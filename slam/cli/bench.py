"""`wclm bench`: measurements side by side."""

from __future__ import annotations

from typing import Annotated

import typer

from .console import progress

bench = typer.Typer(no_args_is_help=True, help="Measure how fast and how accurate parts are.")


@bench.command("features")
def bench_features() -> None:
    """Time the ways to find lines in a scan, by the number of beams, on one core.

    Example: [bold]wclm bench features[/bold]
    """
    from features.benchmark import run

    typer.echo("method/estimator      beams  lines  median us   99 % us")
    for row in run():
        typer.echo(f"{row.name:<21} {row.beams:5d} {row.lines:6.1f} {row.median_us:10.1f} {row.p99_us:9.1f}")


@bench.command("consistency")
def bench_consistency(
    runs: Annotated[int, typer.Option("--runs", min=1, help="Simulated drives, each with other noise.")] = 100,
    duration: Annotated[float, typer.Option("--duration", help="Seconds of each.")] = 60.0,
) -> None:
    """Compare errors with covariances, over simulated drives where the truth is known; two seconds a drive.

    The lidar is mounted off-centre and turned by 100 degrees. 1 is perfect, more is overconfident.

    Example: [bold]wclm bench consistency --runs 20[/bold]
    """
    from ..monte_carlo import simulate, summarise, table

    found = list(progress(simulate(range(runs), duration), runs, "drives"))
    typer.echo("\n".join(table(summarise(found))))

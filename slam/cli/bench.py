"""`wclm bench`: measurements side by side."""

from __future__ import annotations

import typer

bench = typer.Typer(no_args_is_help=True, help="Measure how fast and how accurate parts are.")


@bench.callback()
def _group() -> None:
    """Keeps `features` a subcommand while it is the only one."""


@bench.command("features")
def bench_features() -> None:
    """Time the ways to find lines in a scan, by the number of beams, on one core.

    Example: [bold]wclm bench features[/bold]
    """
    from features.benchmark import run

    typer.echo("method/estimator      beams  lines  median us   99 % us")
    for row in run():
        typer.echo(f"{row.name:<21} {row.beams:5d} {row.lines:6.1f} {row.median_us:10.1f} {row.p99_us:9.1f}")

"""`wclm bench`: measurements side by side."""

from __future__ import annotations

import typer

bench = typer.Typer(no_args_is_help=True, help="Measure how fast and how accurate parts are.")


@bench.callback()
def _group() -> None:
    """Keeps `features` a subcommand while it is the only one."""


@bench.command("features")
def bench_features() -> None:
    """Compare the ways to fit lines to a scan: time and accuracy.

    Example: [bold]wclm bench features[/bold]
    """
    from features import benchmark

    typer.echo(benchmark.run())

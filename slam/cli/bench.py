"""`wclm bench`: measurements side by side."""

from __future__ import annotations

from typing import Annotated

import typer

bench = typer.Typer(no_args_is_help=True, help="Measure how fast, how accurate and how wary parts are.")


@bench.command("features")
def bench_features() -> None:
    """Time the ways to find lines in a scan, by the number of beams, on one core.

    Example: [bold]wclm bench features[/bold]
    """
    from features.benchmark import run

    typer.echo("method/estimator      beams  lines  median us   99 % us")
    for row in run():
        typer.echo(f"{row.name:<21} {row.beams:5d} {row.lines:6.1f} {row.median_us:10.1f} {row.p99_us:9.1f}")


@bench.command("laps")
def bench_laps(
    world: Annotated[str, typer.Argument(help="A simulated world.")] = "office",
    laps: Annotated[int, typer.Option("--laps", min=1, help="Rounds of its path.")] = 10,
    seed: Annotated[int, typer.Option("--seed", help="Of the noise.")] = 0,
) -> None:
    """Drive the same tour again and again: time a scan and memory must stay as they are.

    Example: [bold]wclm bench laps office --laps 10[/bold]
    """
    from ..benchmarks.laps import run
    from ..config import Config

    typer.echo("lap  median ms  99 % ms  memory MB  keyframes  factors  walls")
    for lap in run(world, laps, Config(), seed=seed):
        sizes = f"{lap.keyframes:9d}  {lap.factors:7d}  {lap.walls:5d}"
        typer.echo(f"{lap.number:3d}  {lap.median:9.2f}  {lap.p99:7.2f}  {lap.memory:9.0f}  {sizes}")

"""`wclm bench laps`: time per scan and memory over many laps of one tour."""

from __future__ import annotations

from typing import Annotated

import typer


def bench_laps(
    world: Annotated[str, typer.Argument(metavar="WORLD", help="Name of a built-in world.")] = "office",
    laps: Annotated[int, typer.Option("--laps", min=1, help="Number of laps of the world's path.")] = 10,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the sensor noise.")] = 0,
) -> None:
    """Measure time per scan and memory over many laps of one tour; both must stay constant.

    Example: [bold]wclm bench laps office --laps 10[/bold]
    """
    from ....config import Config
    from ....evaluation.benchmarks.lap_cost import measure_laps

    typer.echo("lap  median ms  99 % ms  memory MB  keyframes  factors  walls")
    for lap in measure_laps(world, laps, Config(), seed=seed):
        sizes = f"{lap.keyframes:9d}  {lap.factors:7d}  {lap.walls:5d}"
        typer.echo(f"{lap.number:3d}  {lap.median:9.2f}  {lap.p99:7.2f}  {lap.memory:9.0f}  {sizes}")

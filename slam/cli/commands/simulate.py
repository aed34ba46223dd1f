"""`wclm simulate`: recording of a simulated robot, with ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..console import progress
from ..options import OverwriteOption, WorldArgument


def simulate(
    world: WorldArgument,
    file: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="Recording to write.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensor noise.")] = 0,
    duration: Annotated[
        float | None, typer.Option("--duration", help="Duration in seconds; by default the world's path once.")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Record a drive of a simulated robot, with ground truth.

    Example: [bold]wclm simulate office office.mcap --seed 3[/bold]
    """
    from drivers.recordings.mcap import McapWriter
    from drivers.simulation import Simulation

    from ...io.unfinished_file import unfinished_file

    if file.suffix != ".mcap":
        raise typer.BadParameter(f"{file}: the name must end with .mcap", param_hint="FILE.mcap")
    source = Simulation(world, seed=seed, duration=duration)
    with unfinished_file(file, overwrite) as unfinished, McapWriter(unfinished) as writer:
        for message in progress(source, len(source), source.name):
            writer.write(message)
    typer.echo(f"{file}: {source.report.messages} messages of {source.name}, seed {seed}")

"""`wclm simulate`: a recording with the truth in it, out of a made-up building."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..console import progress
from ..options import OverwriteOption


def simulate(
    world: Annotated[str, typer.Argument(help="The name of a world that comes with the program, or a TOML file.")],
    file: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="The recording to write.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensors' noise.")] = 0,
    duration: Annotated[
        float | None, typer.Option("--duration", help="Seconds; without it the world's path is driven once.")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Drive a simulated robot through a world and record what it measures, with its true path.

    Example: [bold]wclm simulate office office.mcap --seed 3[/bold]
    """
    from drivers.recordings.mcap import McapWriter
    from drivers.simulation import Simulation

    from ...io.output_dir import unfinished_file

    if file.suffix != ".mcap":
        raise typer.BadParameter(f"{file}: the name must end with .mcap", param_hint="FILE.mcap")
    source = Simulation(world, seed=seed, duration=duration)
    with unfinished_file(file, overwrite) as unfinished, McapWriter(unfinished) as writer:
        for message in progress(source, len(source), source.name):
            writer.write(message)
    typer.echo(f"{file}: {source.report.messages} messages of {source.name}, seed {seed}")

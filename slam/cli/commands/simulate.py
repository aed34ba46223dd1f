"""`wclm simulate`: recording of a simulated robot, with ground truth."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from ..console import progress
from ..options import OverwriteOption, TruthOption, WorldArgument


def simulate(
    world: WorldArgument,
    file: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="Recording to write.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensor noise.")] = 0,
    duration: Annotated[
        float | None, typer.Option("--duration", help="Duration in seconds; by default the world's path once.")
    ] = None,
    truth: TruthOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Record a drive of a simulated robot, with ground truth, by which `wclm eval` scores a run.

    Example: [bold]wclm simulate office office.mcap --seed 3[/bold]
    """
    import numpy as np

    from drivers.messages import GroundTruth
    from drivers.recordings.mcap import McapWriter
    from drivers.simulation import Simulation

    from ...io.tum import Trajectory, write_tum
    from ...io.unfinished_file import unfinished_file

    if file.suffix != ".mcap":
        raise typer.BadParameter(f"{file}: the name must end with .mcap", param_hint="FILE.mcap")
    source = Simulation(world, seed=seed, duration=duration)
    path: list[GroundTruth] = []
    with ExitStack() as files:
        truth_file = None if truth is None else files.enter_context(unfinished_file(truth, overwrite))
        writer = files.enter_context(McapWriter(files.enter_context(unfinished_file(file, overwrite))))
        for message in progress(source, len(source), source.name):
            writer.write(message)
            if isinstance(message, GroundTruth):
                path.append(message)
        if truth_file is not None:
            stamps, poses = np.array([one.stamp for one in path]), np.array([one.pose for one in path])
            write_tum(truth_file, Trajectory(stamps, poses))
    typer.echo(f"{file}: {source.report.messages} messages of {source.name}, seed {seed}")

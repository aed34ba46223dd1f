"""`wclm demo`: mapping of a simulated museum, with a loop that is closed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..options import OverwriteOption, RefineOption

WORLD = "museum"
LIDAR, WHEELS = "short", "bad"
"""Range of 6 m and worn wheels, so that the map drifts by metres before the loop is closed."""


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Output directory.")] = Path("demo"),
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensor noise.")] = 0,
    overwrite: OverwriteOption = False,
    refine: RefineOption = False,
    view: Annotated[bool, typer.Option("--view/--no-view", help="Open the viewer if there is a display.")] = True,
    pictures: Annotated[
        Path | None,
        typer.Option(
            "--gallery", metavar="DIR", help="Only write the pictures of the documentation into this directory."
        ),
    ] = None,
) -> None:
    """Map a simulated museum with worn wheels, close the loop, and open the review log in the viewer.

    With --gallery all pictures of the documentation are written instead, from simulated drives and from the public
    recordings in the directory that the environment variable WCLM_DATASETS names.

    Example: [bold]wclm demo --out demo[/bold]
    """
    if pictures is not None:
        from .demo_pictures import write_pictures

        for path in write_pictures(pictures):
            typer.echo(path)
        return
    from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation

    from ...config import Config
    from ...io.output_dir import CLOSURE_PICTURE
    from ...io.unfinished_file import unfinished_file
    from ...run_setup import RunSetup
    from ..run_input import RecordingInput
    from ..run_summary import format_summary
    from ..slam_run import run_slam
    from ..viewer import has_display, open_viewer, viewer_command
    from .demo_recorders import ClosureRecorder

    simulation = Simulation(WORLD, seed=seed, lidar=LIDAR_MODELS[LIDAR], wheels=WHEEL_MODELS[WHEELS])
    run_input = RecordingInput(simulation, reopen=f"sim:{WORLD}?lidar={LIDAR}&odometry={WHEELS}&seed={seed}")
    run_input.sinks = [closure := ClosureRecorder()]
    result = run_slam(
        run_input, RunSetup(Config()), out, overwrite=overwrite, review=True, picture=True, refine=refine, seed=seed
    )
    if closure.found:
        with unfinished_file(out / CLOSURE_PICTURE) as unfinished:
            closure.plot(unfinished)
    typer.echo("\n".join(format_summary(result, out)))
    if view and has_display():
        open_viewer(viewer_command(out))

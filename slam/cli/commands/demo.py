"""`wclm demo`: everything at once, on a simulated robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..options import OverwriteOption, RefineOption

WORLD = "office"


def demo(
    out: Annotated[Path, typer.Option("--out", help="Directory for the results.")] = Path("demo"),
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensors' noise.")] = 0,
    overwrite: OverwriteOption = False,
    refine: RefineOption = False,
    view: Annotated[bool, typer.Option("--view/--no-view", help="Open the log if there is a display.")] = True,
    pictures: Annotated[
        Path | None,
        typer.Option("--gallery", metavar="DIR", help="Instead, make the documentation's pictures in this directory."),
    ] = None,
) -> None:
    """Drive a simulated robot through an office, map it, and open the log in the viewer.

    With --gallery all pictures of the documentation are made again, over those that are there: of simulated drives,
    and of the public recordings where the environment variable WCLM_DATASETS names the folder that has them.

    Example: [bold]wclm demo --out demo[/bold]
    """
    if pictures is not None:
        from .demo_pictures import write_pictures

        for path in write_pictures(pictures):
            typer.echo(path)
        return
    from drivers.simulation.simulator import Simulation

    from ...config import Config
    from ..run_input import RecordingInput
    from ..run_summary import format_summary
    from ..slam_run import run_slam
    from ..viewer import has_display, open_viewer, viewer_command

    run_input = RecordingInput(Simulation(WORLD, seed=seed), reopen=f"sim:{WORLD}?seed={seed}")
    result = run_slam(
        run_input, Config(), out, overwrite=overwrite, review=True, picture=True, refine=refine, seed=seed
    )
    typer.echo("\n".join(format_summary(result, out)))
    if view and has_display():
        open_viewer(viewer_command(out))

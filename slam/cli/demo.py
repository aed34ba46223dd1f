"""`wclm demo`: everything at once, on a simulated robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import OverwriteOption, RefineOption

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
        from .gallery import make_gallery

        for path in make_gallery(pictures):
            typer.echo(path)
        return
    from drivers.simulation.simulator import Simulation

    from ..config import Config
    from .report import lines_for_people
    from .session import Playback, map_feed
    from .viewer import has_display, open_viewer, viewer_command

    feed = Playback(Simulation(WORLD, seed=seed), reopen=f"sim:{WORLD}?seed={seed}")
    outcome = map_feed(feed, Config(), out, overwrite=overwrite, review=True, picture=True, refine=refine, seed=seed)
    typer.echo("\n".join(lines_for_people(outcome, out)))
    if view and has_display():
        open_viewer(viewer_command(out))

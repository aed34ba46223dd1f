"""`wclm demo`: everything at once, on a simulated robot."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from .console import OverwriteOption, complain

WORLD = "office"


def demo(
    out: Annotated[Path, typer.Option("--out", help="Directory for the results.")] = Path("demo"),
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensors' noise.")] = 0,
    overwrite: OverwriteOption = False,
    view: Annotated[bool, typer.Option("--view/--no-view", help="Open the log if there is a display.")] = True,
) -> None:
    """Drive a simulated robot through an office, map it, and open the log in the viewer.

    Example: [bold]wclm demo --out demo[/bold]
    """
    from drivers.simulator import Simulation

    from ..config import Config
    from .report import lines_for_people, viewer_command
    from .session import map_source

    source = Simulation(WORLD, seed=seed)
    outcome = map_source(source, Config(), out, overwrite=overwrite, review=True, picture=True, seed=seed)
    typer.echo("\n".join(lines_for_people(outcome, out)))
    if view and has_display():
        open_viewer(viewer_command(out))


def has_display() -> bool:
    """Whether a window could be opened."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def open_viewer(command: list[str]) -> None:
    """Start the viewer and let it live on; that it cannot be started is no failure of the demo."""
    try:
        subprocess.Popen(
            command,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError as error:
        complain(f"the viewer cannot be started: {error}")

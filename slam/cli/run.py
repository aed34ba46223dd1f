"""`wclm run`: SLAM over a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import OverwriteOption, RefineOption, SetOption


def run(
    recording: Annotated[str, typer.Argument(help="A CARMEN log, MCAP file, ROS 1 bag or ROS 2 bag directory.")],
    out: Annotated[Path, typer.Option("--out", help="Directory for the results; made if it is not there.")],
    overwrite: OverwriteOption = False,
    refine: RefineOption = False,
    config: Annotated[Path | None, typer.Option("--config", help="Settings, a TOML file.")] = None,
    settings: SetOption = None,
    review: Annotated[bool, typer.Option("--review/--no-review", help="Write the log for the viewer.")] = True,
    plot: Annotated[bool, typer.Option("--plot", help="Draw the map as map.png, too.")] = False,
) -> None:
    """Map a recording: write the path, the map and a log to look at.

    Example: [bold]wclm run intel.clf --out results/intel --plot[/bold]
    """
    import drivers

    from ..config import load_config
    from .report import lines_for_people
    from .session import lasting, map_source

    effective = load_config(config, settings or ())
    source = drivers.open(recording)
    outcome = map_source(
        source,
        effective,
        out,
        overwrite=overwrite,
        review=review,
        picture=plot,
        refine=refine,
        reopen=lasting(recording),
    )
    typer.echo("\n".join(lines_for_people(outcome, out)))

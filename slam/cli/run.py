"""`wclm run`: SLAM over a recording."""

from __future__ import annotations

from typing import Annotated

import typer

from .console import (
    ConfigOption,
    OutOption,
    OverwriteOption,
    PlotOption,
    RefineOption,
    ReviewOption,
    SetOption,
)


def run(
    recording: Annotated[str, typer.Argument(help="A CARMEN log, MCAP file, ROS 1 bag or ROS 2 bag directory.")],
    out: OutOption,
    overwrite: OverwriteOption = False,
    refine: RefineOption = False,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
    plot: PlotOption = False,
) -> None:
    """Map a recording: write the path, the map and a log to look at.

    Example: [bold]wclm run intel.clf --out results/intel --plot[/bold]
    """
    import drivers

    from ..config import load_config
    from .report import lines_for_people
    from .session import Playback, lasting, map_feed

    effective = load_config(config, settings or ())
    feed = Playback(drivers.open(recording), reopen=lasting(recording))
    outcome = map_feed(feed, effective, out, overwrite=overwrite, review=review, picture=plot, refine=refine)
    typer.echo("\n".join(lines_for_people(outcome, out)))

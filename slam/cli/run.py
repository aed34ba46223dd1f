"""`wclm run`: SLAM over a recording."""

from __future__ import annotations

from typing import Annotated

import typer

from .console import (
    ConfigOption,
    ContinueOption,
    LocalizeOption,
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
    continued: ContinueOption = None,
    localized: LocalizeOption = None,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
    plot: PlotOption = False,
) -> None:
    """Map a recording: write the path, the map and a log to look at.

    With --continue the new drive may begin anywhere on the old map, or go on where the old one ended.

    Example: [bold]wclm run intel.clf --out results/intel --plot[/bold]
    """
    import drivers

    from .report import lines_for_people
    from .session import Playback, begin, lasting, map_feed

    start = begin(continued, localized, config, settings)
    feed = Playback(drivers.open(recording), reopen=lasting(recording))
    outcome = map_feed(
        feed,
        start.config,
        out,
        overwrite=overwrite,
        review=review,
        picture=plot,
        refine=refine,
        resumed=start.resumed,
        frozen=start.frozen,
    )
    typer.echo("\n".join(lines_for_people(outcome, out)))

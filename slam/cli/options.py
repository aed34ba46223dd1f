"""Options and arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..extras import require_extra


def check_plots_extra(plot: bool) -> bool:
    """Check before a run starts that plots can be drawn. Raises MissingExtraError."""
    if plot:
        require_extra("plots")
    return plot


RecordingArgument = Annotated[
    str,
    typer.Argument(
        help="Recording: CARMEN log, MCAP file, ROS 1 bag, ROS 2 bag directory, or simulation (sim:office?seed=3)."
    ),
]
SessionArgument = Annotated[Path, typer.Argument(help="Output directory of `wclm run`.")]
WorldArgument = Annotated[str, typer.Argument(help="Name of a built-in world, or a TOML file.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="GROUP.KEY=VALUE", help="One setting, e.g. lidar.sigma_range=0.02; can be repeated."),
]
ConfigOption = Annotated[Path | None, typer.Option("--config", metavar="FILE.toml", help="Settings file.")]
OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Output directory; created if missing.")]
ReviewOption = Annotated[bool, typer.Option("--review/--no-review", help="Write the review log, review.rrd.")]
PlotOption = Annotated[
    bool, typer.Option("--plot", callback=check_plots_extra, help="Write a picture of the map, map.png.")
]
DurationOption = Annotated[
    float | None,
    typer.Option("--duration", metavar="SECONDS", min=0.0, help="Duration in seconds; by default until Ctrl-C."),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace existing results.")]
ContinueOption = Annotated[
    Path | None,
    typer.Option("--continue", metavar="SESSION", help="Output directory of an earlier run whose map to extend."),
]
LocalizeOption = Annotated[
    Path | None,
    typer.Option(
        "--localize",
        metavar="SESSION",
        help="Output directory of an earlier run on whose map to localise only; the map is not changed.",
    ),
]
NoOdometryOption = Annotated[
    bool,
    typer.Option("--no-odometry", help="Map by the scans alone; done anyway if there is no odometry."),
]
StartOption = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="X,Y,HEADING",
        help="With --continue or --localize: roughly where the robot starts in the map (metres, radians).",
    ),
]
RefineOption = Annotated[
    bool, typer.Option("--refine", help="Refine the whole session after the last scan, as `wclm optimize` does.")
]

"""Options and arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..extras import require_extra
from ..io.output_dir import refuse_results
from ..io.plans.units import Unit

if TYPE_CHECKING:
    from drivers import se2


def check_plots_extra(plot: bool) -> bool:
    """Check before a run starts that plots can be drawn. Raises MissingExtraError."""
    if plot:
        require_extra("plots")
    return plot


def check_picture(path: Path | None) -> Path | None:
    """Check before a command starts that a picture can be drawn. Raises BadParameter or MissingExtraError."""
    if path is not None:
        if path.suffix != ".png":
            raise typer.BadParameter(f"{path}: the name must end with .png")
        if not path.parent.is_dir():
            raise typer.BadParameter(f"{path}: there is no directory {path.parent}")
        require_extra("plots")
    return path


def parse_pose(text: str | None, option: str) -> se2.Pose | None:
    """Return the pose (3,) [x, y, heading] that an option states; raises BadParameter if it is not three numbers."""
    import numpy as np

    if text is None:
        return None
    try:
        pose = np.array([float(part) for part in text.split(",")])
    except ValueError:
        pose = np.zeros(0)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise typer.BadParameter(f"{text}: must be three numbers, e.g. 1.5,-2,3.14", param_hint=option)
    return pose


RecordingArgument = Annotated[
    str,
    typer.Argument(
        metavar="RECORDING",
        callback=refuse_results,
        help="Recording: CARMEN log, MCAP file, ROS 1 bag, ROS 2 bag directory, or simulation (sim:office?seed=3).",
    ),
]
OtherRecordingArgument = Annotated[
    str, typer.Argument(metavar="RECORDING", callback=refuse_results, help="Recording, as for `wclm run`.")
]
SessionArgument = Annotated[Path, typer.Argument(metavar="SESSION", help="Output directory of `wclm run`.")]
WorldArgument = Annotated[
    str,
    typer.Argument(metavar="WORLD", help="Built-in world, e.g. office; an unknown name lists all. Or a TOML file."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="GROUP.KEY=VALUE", help="One setting, e.g. lidar.delay=0.1; can be repeated."),
]
ConfigOption = Annotated[Path | None, typer.Option("--config", metavar="FILE.toml", help="Settings file.")]
OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Output directory; created if missing.")]
ReviewOption = Annotated[bool, typer.Option("--review/--no-review", help="Write the review log, review.rrd.")]
PlotOption = Annotated[
    bool, typer.Option("--plot", callback=check_plots_extra, help="Write a picture of the map, map.png.")
]
DurationOption = Annotated[
    float | None,
    typer.Option(
        "--duration",
        metavar="SECONDS",
        min=0.0,
        help="Seconds after the devices have started; by default until Ctrl-C.",
    ),
]
TruthOption = Annotated[Path | None, typer.Option("--truth", metavar="FILE.tum", help="File for the true trajectory.")]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace existing output.")]
ContinueOption = Annotated[
    Path | None,
    typer.Option("--continue", metavar="SESSION", help="Output directory of an earlier run whose map to extend."),
]
LocalizeOption = Annotated[
    Path | None,
    typer.Option(
        "--localize",
        metavar="MAP",
        help="Map to localise on without changing it: output directory of an earlier run, or a plan (see --plan).",
    ),
]
PlanOption = Annotated[
    Path | None,
    typer.Option(
        "--plan",
        metavar="FILE",
        help="Plan of the building whose walls help mapping: DXF, GeoJSON or SVG drawing, grid map of ROS (YAML), or "
        "output directory of an earlier run. The map is in its frame.",
    ),
]
PlanUnitOption = Annotated[
    Unit | None,
    typer.Option("--plan-unit", help="Unit of length of a drawing; by default as it states, else metres."),
]
PlanLayerOption = Annotated[
    list[str] | None,
    typer.Option("--plan-layer", metavar="NAME", help="Layer of a DXF drawing with walls; can be repeated."),
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
        help="With --continue, --localize or --plan: roughly where the robot starts in the map (metres, radians).",
    ),
]
RegularOption = Annotated[
    bool,
    typer.Option(
        "--regular", help="Make walls parallel and angles right where the covariances support it; others stay."
    ),
]
RefineOption = Annotated[
    bool, typer.Option("--refine", help="Refine the whole session after the last scan, as `wclm optimize` does.")
]

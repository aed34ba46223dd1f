"""`wclm live`: online SLAM with devices."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..device_options import BaseOption, LidarOption, check_recording_file, parse_device_options
from ..options import (
    ConfigOption,
    ContinueOption,
    DurationOption,
    LocalizeOption,
    NoOdometryOption,
    OutOption,
    OverwriteOption,
    PlotOption,
    RefineOption,
    ReviewOption,
    SetOption,
    StartOption,
)

if TYPE_CHECKING:
    from ...visualisation.rerun_log import ViewerServer


def live(
    out: OutOption,
    lidar: LidarOption = None,
    base: BaseOption = None,
    record: Annotated[
        Path | None, typer.Option("--record", metavar="FILE.mcap", help="Recording of all measurements.")
    ] = None,
    duration: DurationOption = None,
    overwrite: OverwriteOption = False,
    refine: RefineOption = False,
    no_odometry: NoOdometryOption = False,
    continued: ContinueOption = None,
    localized: LocalizeOption = None,
    start_pose: StartOption = None,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
    serve: Annotated[
        bool, typer.Option("--serve/--no-serve", help="Serve the review log to viewers during the run.")
    ] = True,
    address: Annotated[
        str, typer.Option("--address", help="Address for viewers; 0.0.0.0 admits other computers.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(
            "--port", min=1, max=65535, help="Port for viewers; by default 9877, or a free one if that is in use."
        ),
    ] = None,
    plot: PlotOption = False,
) -> None:
    """Map online with a lidar, and a wheel base if there is one, until Ctrl-C; then write the results.

    Example: [bold]wclm live --lidar rplidar:/dev/ttyUSB0 --base create2:/dev/ttyUSB1 --out map --record map.mcap[/bold]
    """
    from ..run_summary import format_summary
    from ..slam_run import prepare_run, run_slam, without_odometry
    from .live_input import LiveInput

    start = prepare_run(continued, localized, config, settings, start_pose)
    if not lidar:
        raise typer.BadParameter("a lidar is required", param_hint="--lidar")
    if no_odometry or not base:
        start = without_odometry(start, "--no-odometry" if no_odometry else "no --base")
    specs = parse_device_options(lidar, base)
    if record is not None:
        check_recording_file(record, overwrite)
    with _server(address, port) if review and serve else nullcontext() as server:
        live_input = LiveInput(specs, record, duration, server)
        result = run_slam(
            live_input,
            start.config,
            out,
            overwrite=overwrite,
            review=review,
            picture=plot,
            refine=refine,
            resumed=start.resumed,
            frozen=start.frozen,
            start=start.pose,
            server=server,
        )
    typer.echo("\n".join(format_summary(result, out)))
    if live_input.failure is not None:
        raise live_input.failure


def _server(address: str, port: int | None) -> ViewerServer:
    from ...visualisation.rerun_log import ViewerServer

    return ViewerServer(address, port)

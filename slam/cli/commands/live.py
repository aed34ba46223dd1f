"""`wclm live`: online SLAM with devices."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..device_options import (
    BaseOption,
    LidarOption,
    MaxSpeedOption,
    MaxTurnRateOption,
    check_recording_file,
    parse_device_options,
    parse_drive_options,
)
from ..options import (
    ConfigOption,
    ContinueOption,
    DurationOption,
    LocalizeOption,
    NoOdometryOption,
    OutOption,
    OverwriteOption,
    PlanLayerOption,
    PlanOption,
    PlanUnitOption,
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
    drive: Annotated[bool, typer.Option("--drive", help="Drive the robot with the arrow keys.")] = False,
    max_speed: MaxSpeedOption = None,
    max_turn_rate: MaxTurnRateOption = None,
    overwrite: OverwriteOption = False,
    refine: RefineOption = False,
    no_odometry: NoOdometryOption = False,
    continued: ContinueOption = None,
    localized: LocalizeOption = None,
    plan: PlanOption = None,
    plan_unit: PlanUnitOption = None,
    plan_layer: PlanLayerOption = None,
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
    web: Annotated[bool, typer.Option("--web", help="Serve a page that shows the run in a browser.")] = False,
    web_address: Annotated[
        str | None,
        typer.Option(
            "--web-address",
            metavar="HOST[:PORT]",
            help="Address of the page, by default 127.0.0.1:8090; with any other than this computer's own, as 0.0.0.0, "
            "the URL contains a password.",
        ),
    ] = None,
    plot: PlotOption = False,
) -> None:
    """Map online with a lidar, and a wheel base if there is one, until Ctrl-C; then write the results.

    Example: [bold]wclm live --lidar rplidar:/dev/ttyUSB0 --base create2:/dev/ttyUSB1 --out map --record map.mcap[/bold]
    """
    from ..plan_input import PlanOptions
    from ..run_summary import format_summary
    from ..slam_run import prepare_run, run_slam, without_odometry
    from ..terminal_keys import TerminalKeys
    from .live_input import LiveInput
    from .live_web import open_page

    start = prepare_run(
        continued, localized, config, settings, start_pose, PlanOptions(plan, plan_unit, plan_layer or ())
    )
    if not lidar:
        raise typer.BadParameter("a lidar is required", param_hint="--lidar")
    specs = parse_device_options(lidar, base)
    driving = parse_drive_options(drive, max_speed, max_turn_rate, specs)
    if driving is not None and not (web or web_address is not None or sys.stdin.isatty()):
        raise typer.BadParameter("there is no keyboard: standard input is not a terminal", param_hint="--drive")
    if no_odometry or not base:
        start = without_odometry(start, "--no-odometry" if no_odometry else "no --base")
    if record is not None:
        check_recording_file(record, overwrite)
    with (
        _server(address, port) if review and serve else nullcontext() as server,
        open_page(web_address) if web or web_address is not None else nullcontext() as page,
    ):
        keys = TerminalKeys()
        live_input = LiveInput(specs, record, duration, server, driving, keys, page)
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
            plan=start.plan,
            server=server,
            keys=keys,
            page=page,
        )
    typer.echo("\n".join(format_summary(result, out)))
    if live_input.failure is not None:
        raise live_input.failure


def _server(address: str, port: int | None) -> ViewerServer:
    from ...visualisation.rerun_log import ViewerServer

    return ViewerServer(address, port)

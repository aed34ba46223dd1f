"""`wclm live`: online SLAM with devices."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING

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
from .live_options import (
    AddressOption,
    DriveOption,
    PortOption,
    RecordFileOption,
    ServeOption,
    StatusOption,
    WebAddressOption,
    WebOption,
)

if TYPE_CHECKING:
    from pathlib import Path

    from drivers.devices.device_spec import DeviceSpec
    from drivers.devices.driving import DriveLimits

    from ...visualisation.rerun_log import ViewerServer


def live(
    out: OutOption,
    lidar: LidarOption = None,
    base: BaseOption = None,
    record: RecordFileOption = None,
    duration: DurationOption = None,
    drive: DriveOption = False,
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
    serve: ServeOption = True,
    address: AddressOption = "127.0.0.1",
    port: PortOption = None,
    web: WebOption = False,
    web_address: WebAddressOption = None,
    status: StatusOption = None,
    plot: PlotOption = False,
) -> None:
    """Map online with a lidar, and a wheel base if there is one, until Ctrl-C; then write the results.

    Example: [bold]wclm live --lidar rplidar:/dev/ttyUSB0 --base create2:/dev/ttyUSB1 --out map --record map.mcap[/bold]
    """
    from drivers.recordings.mcap import SCAN_TOPICS

    from ...errors import MapError
    from ..plan_input import PlanOptions
    from ..run_controls import RunControls
    from ..run_summary import format_summary
    from ..setup_from_options import setup_from_options, without_odometry
    from ..slam_run import run_slam
    from ..status_file import StatusFile
    from .live_input import LiveInput
    from .live_web import open_page

    on_plan = PlanOptions(plan, plan_unit, plan_layer or ())
    setup = setup_from_options(continued, localized, config, settings, start_pose, on_plan)
    with_page = web or web_address is not None
    specs, driving = _devices(lidar, base, drive, max_speed, max_turn_rate, with_page=with_page)
    _check_files(record, status, out, overwrite=overwrite)
    if sum(spec.is_lidar for spec in specs) > 1:
        setup = replace(setup, config=setup.config.with_two_lidars(*SCAN_TOPICS))
    if no_odometry or not base:
        setup = without_odometry(setup, "--no-odometry" if no_odometry else "no --base")
    with (
        _server(address, port) if review and serve else nullcontext() as server,
        open_page(web_address) if with_page else nullcontext() as page,
    ):
        controls, status_file = RunControls(server, page), None if status is None else StatusFile(status, out)
        live_input = LiveInput(specs, record, duration, driving, controls, status_file, setup.resumed)
        results = {"overwrite": overwrite, "review": review, "picture": plot, "refine": refine}
        try:
            result = run_slam(live_input, setup, out, **results, controls=controls)
        except MapError as error:  # the devices have ended before anything could be mapped
            if live_input.failure is None:
                raise
            raise live_input.failure from error
        if status_file is not None:
            status_file.finish()
    typer.echo("\n".join(format_summary(result, out)))
    if live_input.failure is not None:
        raise live_input.failure


def _check_files(record: Path | None, status: Path | None, out: Path, *, overwrite: bool) -> None:
    """Check the files of `--record` and `--status`, which must not be in the output directory, as that is replaced.

    Raises BadParameter or RecordingError.
    """
    if record is not None:
        check_recording_file(record, overwrite, "--record")
    for option, file in (("--record", record), ("--status", status)):
        if file is not None and out.resolve() in file.resolve().parents:
            raise typer.BadParameter(f"{file}: must not be in the output directory {out}", param_hint=option)


def _devices(
    lidar: list[str] | None,
    base: list[str] | None,
    drive: bool,
    max_speed: float | None,
    max_turn_rate: float | None,
    *,
    with_page: bool,
) -> tuple[list[DeviceSpec], DriveLimits | None]:
    """Return the devices, and the limits of the base if it is driven.

    Raises DriverError or BadParameter if the options do not fit, or if neither a terminal nor a page can drive.
    """
    if not lidar:
        raise typer.BadParameter("no lidar is given; `wclm devices` lists them", param_hint="--lidar")
    specs = parse_device_options(lidar, base)
    driving = parse_drive_options(drive, max_speed, max_turn_rate, specs)
    if driving is not None and not (with_page or sys.stdin.isatty()):
        raise typer.BadParameter("there is no keyboard: standard input is not a terminal", param_hint="--drive")
    return specs, driving


def _server(address: str, port: int | None) -> ViewerServer:
    from ...visualisation.rerun_log import ViewerServer

    return ViewerServer(address, port)

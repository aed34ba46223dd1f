"""`wclm emulate`: a robot to try things with where there is none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..options import DurationOption

if TYPE_CHECKING:
    from drivers.emulator import Emulator, EmulatorSetup


def _fault(option: str, text: str, **more: Any) -> Any:
    return typer.Option(option, help=text, rich_help_panel="Faults", **more)


def _chance(option: str, text: str) -> Any:
    return _fault(option, text, min=0.0, max=1.0)


def _event(option: str, when: str, text: str) -> Any:
    return _fault(option, f"{text} Seconds since the start; may be repeated.", metavar=f"DEVICE@{when}")


WorldArgument = Annotated[str, typer.Argument(help="The name of a world that comes with the program, or a TOML file.")]
LidarKindOption = Annotated[str, typer.Option("--lidar", help="Which lidar; a wrong name lists them.")]
BaseKindOption = Annotated[str, typer.Option("--base", help="Which wheel base; a wrong name lists them.")]
PortsOption = Annotated[Path | None, typer.Option("--ports", help="Directory for the ports `lidar` and `base`.")]
LidarPortOption = Annotated[Path | None, typer.Option("--lidar-port", help="Name of the lidar's port.")]
BasePortOption = Annotated[Path | None, typer.Option("--base-port", help="Name of the base's port.")]
DriveOption = Annotated[
    str, typer.Option("--drive", help="path: along the world's; base: as the base is told; keyboard: arrow keys.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensors' noise and of the faults.")]
TruthOption = Annotated[
    Path | None, typer.Option("--truth", metavar="FILE.tum", help="Write the true path, for scoring a live run.")
]
ReportOption = Annotated[
    Path | None, typer.Option("--report", metavar="FILE.json", help="Write what happened, faults counted, at the end.")
]
DropOption = Annotated[float, _chance("--drop", "Share of bytes that get lost.")]
InsertOption = Annotated[float, _chance("--insert", "Share of bytes with one too many before.")]
FlipOption = Annotated[float, _chance("--flip", "Share of bytes with a wrong bit.")]
UnplugOption = Annotated[list[str] | None, _event("--unplug", "TIME:FOR", "The port disappears.")]
StallOption = Annotated[list[str] | None, _event("--stall", "TIME:FOR", "It falls silent.")]
RestartOption = Annotated[list[str] | None, _event("--restart", "TIME", "It starts again.")]
FailOption = Annotated[list[str] | None, _event("--fail", "TIME", "It needs a reset.")]
LidarDriftOption = Annotated[float, _fault("--lidar-drift", "How fast its clock is, parts per million.")]
BaseDriftOption = Annotated[float, _fault("--base-drift", "How fast its clock is, parts per million.")]


def emulate(
    world: WorldArgument,
    lidar: LidarKindOption = "rplidar-s1",
    base: BaseKindOption = "create2",
    ports: PortsOption = None,
    lidar_port: LidarPortOption = None,
    base_port: BasePortOption = None,
    drive: DriveOption = "path",
    duration: DurationOption = None,
    seed: SeedOption = 0,
    truth: TruthOption = None,
    report: ReportOption = None,
    drop: DropOption = 0.0,
    insert: InsertOption = 0.0,
    flip: FlipOption = 0.0,
    unplug: UnplugOption = None,
    stall: StallOption = None,
    restart: RestartOption = None,
    fail: FailOption = None,
    lidar_drift: LidarDriftOption = 0.0,
    base_drift: BaseDriftOption = 0.0,
) -> None:
    """Be a robot in a made-up building: a lidar and a wheel base on two serial ports, for other programs to open.

    Example: [bold]wclm emulate office --lidar rplidar-s1 --base create2 --truth truth.tum[/bold]
    """
    from drivers.emulator import FaultEvent, EmulatorSetup
    from drivers.emulator.emulator_setup import default_ports

    folder = ports or default_ports()
    faults = {"unplug": unplug, "stall": stall, "restart": restart, "fail": fail}
    setup = EmulatorSetup(
        world,
        lidar=lidar,
        base=base,
        lidar_port=lidar_port or folder / "lidar",
        base_port=base_port or folder / "base",
        drive=drive,
        seed=seed,
        drop=drop,
        insert=insert,
        flip=flip,
        events=tuple(FaultEvent.parse(kind, text) for kind, texts in faults.items() for text in texts or []),
        lidar_drift=lidar_drift,
        base_drift=base_drift,
        truth=truth,
        report=report,
    )
    _run(setup, duration)


def _run(setup: EmulatorSetup, duration: float | None) -> None:
    """Be the robot for a duration (seconds), or until Ctrl-C."""
    from drivers.emulator import Emulator
    from drivers.emulator.keyboard import HELP

    with Emulator(setup) as emulator:
        _greet(emulator)
        if setup.drive == "keyboard":
            typer.echo(HELP)
        try:
            emulator.run(duration)
        except KeyboardInterrupt:
            typer.echo("", err=True)  # the terminal shows ^C
    for link in (emulator.lidar, emulator.base):
        told = link.report()
        typer.echo(f"{told['device']}: {told['sent']} bytes sent, {told['received']} received")


def _greet(emulator: Emulator) -> None:
    """Say where the devices are."""
    for link in (emulator.lidar, emulator.base):
        told = link.report()
        speed = f"{told['baud']} baud" if told["baud"] else "USB, any speed"
        typer.echo(f"{told['port']}: {told['device']}, {speed}")

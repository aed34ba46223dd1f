"""`wclm emulate`: an emulated robot on two serial ports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..options import DurationOption, TruthOption, WorldArgument

if TYPE_CHECKING:
    from drivers.emulator import Emulator, EmulatorSetup


def _fault(option: str, text: str, **more: Any) -> Any:
    return typer.Option(option, help=text, rich_help_panel="Faults", **more)


def _chance(option: str, text: str) -> Any:
    return _fault(option, text, min=0.0, max=1.0)


def _event(option: str, when: str, text: str) -> Any:
    return _fault(option, f"{text} Times in seconds; can be repeated.", metavar=f"DEVICE@{when}")


LidarKindOption = Annotated[str, typer.Option("--lidar", help="Lidar model; an unknown name lists all.")]
BaseKindOption = Annotated[str, typer.Option("--base", help="Wheel base; an unknown name lists all.")]
PortsOption = Annotated[Path | None, typer.Option("--ports", help="Directory of the ports `lidar` and `base`.")]
LidarPortOption = Annotated[Path | None, typer.Option("--lidar-port", help="Path of the lidar's port.")]
BasePortOption = Annotated[Path | None, typer.Option("--base-port", help="Path of the base's port.")]
DriveOption = Annotated[
    str,
    typer.Option(
        "--drive",
        help="Source of the motion. path: the world's path; base: commands to the base; keyboard: arrow keys.",
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensor noise and the faults.")]
ReportOption = Annotated[
    Path | None, typer.Option("--report", metavar="FILE.json", help="File for counts of measurements and faults.")
]
DropOption = Annotated[float, _chance("--drop", "Share of bytes dropped, 0 to 1.")]
InsertOption = Annotated[float, _chance("--insert", "Share of bytes with a byte inserted before them, 0 to 1.")]
FlipOption = Annotated[float, _chance("--flip", "Share of bytes with one flipped bit, 0 to 1.")]
UnplugOption = Annotated[
    list[str] | None, _event("--unplug", "TIME:FOR", "Time and duration for which the port disappears.")
]
StallOption = Annotated[
    list[str] | None, _event("--stall", "TIME:FOR", "Time and duration for which the device sends nothing.")
]
RestartOption = Annotated[list[str] | None, _event("--restart", "TIME", "Time at which the device restarts.")]
FailOption = Annotated[list[str] | None, _event("--fail", "TIME", "Time at which the device fails until it is reset.")]
LidarDriftOption = Annotated[float, _fault("--lidar-drift", "Error of the lidar's clock rate, parts per million.")]
BaseDriftOption = Annotated[float, _fault("--base-drift", "Error of the base's clock rate, parts per million.")]


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
    """Emulate a robot in a simulated world: a lidar and a wheel base on two serial ports.

    Any program can open the ports as it would those of real devices.

    Example: [bold]wclm emulate office --lidar rplidar-s1 --base create2 --truth truth.tum[/bold]
    """
    from drivers.emulator import EmulatorSetup, FaultEvent
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
    """Run the emulator for a duration (seconds), or until Ctrl-C."""
    from drivers.emulator import Emulator
    from drivers.emulator.keyboard import HELP

    with Emulator(setup) as emulator:
        _print_ports(emulator)
        if setup.drive == "keyboard":
            typer.echo(HELP)
        try:
            emulator.run(duration)
        except KeyboardInterrupt:
            typer.echo("", err=True)  # the terminal shows ^C
    for link in (emulator.lidar, emulator.base):
        report = link.report()
        typer.echo(f"{report['device']}: {report['sent']} bytes sent, {report['received']} received")


def _print_ports(emulator: Emulator) -> None:
    """Print the port and the speed of each device."""
    for link in (emulator.lidar, emulator.base):
        report = link.report()
        speed = f"{report['baud']} baud" if report["baud"] else "USB, any speed"
        typer.echo(f"{report['port']}: {report['device']}, {speed}")

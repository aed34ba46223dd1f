"""`wclm emulate`: a robot to try things with where there is none."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import DurationOption

_FAULTS, _TIMES = "Faults", "Seconds since the start; may be repeated."
_CHANCE = {"min": 0.0, "max": 1.0, "rich_help_panel": _FAULTS}


def emulate(
    world: Annotated[str, typer.Argument(help="The name of a world that comes with the program, or a TOML file.")],
    lidar: Annotated[str, typer.Option("--lidar", help="Which lidar; a wrong name lists them.")] = "rplidar-s1",
    base: Annotated[str, typer.Option("--base", help="Which wheel base; a wrong name lists them.")] = "create2",
    ports: Annotated[Path | None, typer.Option("--ports", help="Directory for the ports `lidar` and `base`.")] = None,
    lidar_port: Annotated[Path | None, typer.Option("--lidar-port", help="Name of the lidar's port.")] = None,
    base_port: Annotated[Path | None, typer.Option("--base-port", help="Name of the base's port.")] = None,
    drive: Annotated[
        str, typer.Option("--drive", help="path: along the world's; base: as the base is told; keyboard: arrow keys.")
    ] = "path",
    duration: DurationOption = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensors' noise and of the faults.")] = 0,
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="FILE.tum", help="Write the true path, for scoring a live run.")
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="FILE.json", help="Write what happened, faults counted, at the end."),
    ] = None,
    drop: Annotated[float, typer.Option("--drop", help="Share of bytes that get lost.", **_CHANCE)] = 0.0,
    insert: Annotated[
        float, typer.Option("--insert", help="Share of bytes with one too many before.", **_CHANCE)
    ] = 0.0,
    flip: Annotated[float, typer.Option("--flip", help="Share of bytes with a wrong bit.", **_CHANCE)] = 0.0,
    unplug: Annotated[
        list[str] | None,
        typer.Option(
            "--unplug", metavar="DEVICE@TIME:FOR", help=f"The port disappears. {_TIMES}", rich_help_panel=_FAULTS
        ),
    ] = None,
    stall: Annotated[
        list[str] | None,
        typer.Option("--stall", metavar="DEVICE@TIME:FOR", help=f"It falls silent. {_TIMES}", rich_help_panel=_FAULTS),
    ] = None,
    restart: Annotated[
        list[str] | None,
        typer.Option("--restart", metavar="DEVICE@TIME", help=f"It starts again. {_TIMES}", rich_help_panel=_FAULTS),
    ] = None,
    fail: Annotated[
        list[str] | None,
        typer.Option("--fail", metavar="DEVICE@TIME", help=f"It needs a reset. {_TIMES}", rich_help_panel=_FAULTS),
    ] = None,
    lidar_drift: Annotated[
        float, typer.Option("--lidar-drift", help="How fast its clock is, parts per million.", rich_help_panel=_FAULTS)
    ] = 0.0,
    base_drift: Annotated[
        float, typer.Option("--base-drift", help="How fast its clock is, parts per million.", rich_help_panel=_FAULTS)
    ] = 0.0,
) -> None:
    """Be a robot in a made-up building: a lidar and a wheel base on two serial ports, for other programs to open.

    Example: [bold]wclm emulate office --lidar rplidar-s1 --base create2 --truth truth.tum[/bold]
    """
    from drivers.emulator import Emulator, Event, Setup
    from drivers.emulator.keyboard import HELP
    from drivers.emulator.setup import default_ports

    folder = ports or default_ports()
    faults = {"unplug": unplug, "stall": stall, "restart": restart, "fail": fail}
    setup = Setup(
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
        events=tuple(Event.parse(kind, text) for kind, texts in faults.items() for text in texts or []),
        lidar_drift=lidar_drift,
        base_drift=base_drift,
        truth=truth,
        report=report,
    )
    with Emulator(setup) as emulator:
        for link in (emulator.lidar, emulator.base):
            told = link.report()
            speed = f"{told['baud']} baud" if told["baud"] else "USB, any speed"
            typer.echo(f"{told['port']}: {told['device']}, {speed}")
        if drive == "keyboard":
            typer.echo(HELP)
        try:
            emulator.run(duration)
        except KeyboardInterrupt:
            typer.echo("", err=True)  # the terminal shows ^C
    for link in (emulator.lidar, emulator.base):
        told = link.report()
        typer.echo(f"{told['device']}: {told['sent']} bytes sent, {told['received']} received")

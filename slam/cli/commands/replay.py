"""`wclm replay`: a recording with its timing."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

EVERY = 0.1
"""Seconds between two looks of the display."""


def replay(
    recording: Annotated[str, typer.Argument(help="A recording, as for `wclm run`, or a tape of raw bytes (.tape).")],
    speed: Annotated[float, typer.Option("--speed", min=0.01, max=1000.0, help="Times as fast as it was.")] = 1.0,
) -> None:
    """Play a recording with its timing and show what was measured when; a tape comes out of a serial port.

    The messages of a recording are shown here; to have them mapped as if the robot drove now, give replay:FILE to a
    command that takes recordings. The bytes of a tape come out of a pseudo terminal, which is named: any program can
    open it as the device's port.

    Example: [bold]wclm replay drive.mcap --speed 4[/bold]
    """
    if Path(recording).suffix == ".tape":
        _play_tape(Path(recording), speed)
    else:
        _play_recording(recording, speed)


def _play_tape(path: Path, speed: float) -> None:
    from drivers.transport.replay_port import ReplayPort

    with ReplayPort(path, speed) as port:
        typer.echo(port.name)
        count = port.play()
    typer.echo(f"{path}: {count} bytes played")


def _play_recording(recording: str, speed: float) -> None:
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    import drivers
    from drivers.messages import Odometry, Scan
    from drivers.recordings.replay import Replay

    source = Replay(drivers.open(recording), speed)
    scans, odometry, first, last, shown = 0, 0, None, 0.0, 0.0
    pose = ""
    console = Console(stderr=True)
    with Live(console=console, auto_refresh=False, transient=True) as live:
        for message in source:
            first = message.stamp if first is None else first
            last = message.stamp
            scans += isinstance(message, Scan)
            if isinstance(message, Odometry):
                odometry += 1
                x, y, heading = message.pose
                pose = f"odometry at {x:.2f} m, {y:.2f} m, {heading:.2f} rad"
            if console.is_terminal and time.monotonic() > shown + EVERY:
                shown = time.monotonic()
                live.update(Text(f"{last - first:8.1f} s  {scans} scans  {odometry} readings  {pose}"), refresh=True)
    length = 0.0 if first is None else last - first
    typer.echo(f"{source.name}: {scans} scans and {odometry} odometry readings, {length:.1f} s at {speed:g} x")

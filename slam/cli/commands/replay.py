"""`wclm replay`: replay of a recording in real time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from ...io.output_dir import refuse_results

DISPLAY_PERIOD = 0.1
"""Seconds between two updates of the display."""


def replay(
    recording: Annotated[
        str,
        typer.Argument(
            metavar="RECORDING",
            callback=refuse_results,
            help="Recording, as for `wclm run`, or byte capture of a device (.tape).",
        ),
    ],
    speed: Annotated[float, typer.Option("--speed", min=0.01, max=1000.0, help="Factor of the original speed.")] = 1.0,
) -> None:
    """Replay a recording in real time and show its progress.

    A byte capture (.tape) is replayed on a pseudo terminal, whose name is printed and which any program can open as the
    device's port. To map a recording in real time, give replay:FILE as the recording of another command.

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
            if console.is_terminal and time.monotonic() > shown + DISPLAY_PERIOD:
                shown = time.monotonic()
                live.update(Text(f"{last - first:8.1f} s  {scans} scans  {odometry} readings  {pose}"), refresh=True)
    length = 0.0 if first is None else last - first
    typer.echo(f"{source.name}: {scans} scans and {odometry} odometry readings, {length:.1f} s at {speed:g} x")

"""`wclm save`: saving the map of a live run that goes on."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Annotated

import typer

from ...errors import OutputError

TIMEOUT = 120.0
"""Seconds to wait for the map, which a slow disk needs some seconds for."""
POLL_PERIOD = 0.1
"""Seconds."""


def save(
    out: Annotated[Path, typer.Argument(metavar="DIR", help="Output directory of a `wclm live` that is running.")],
) -> None:
    """Save the map of a live run now; the run goes on.

    A live run also saves its map every 45 seconds, if the key s is pressed in its terminal, and on SIGUSR1.

    Example: [bold]wclm save map[/bold]
    """
    from ...io.work_directory import running_process

    before = running_process(out)
    if before is None:
        raise OutputError(f"{out}: no live run is writing it")
    os.kill(before["process"], signal.SIGUSR1)
    end = time.monotonic() + TIMEOUT
    while (now := running_process(out)) is not None and now["answers"] == before["answers"]:
        if time.monotonic() > end:
            raise OutputError(f"{out}: the live run has not saved its map within {TIMEOUT:g} s")
        time.sleep(POLL_PERIOD)
    if now is not None and now["problem"]:
        raise OutputError(now["problem"])
    typer.echo(f"{out}: {'saved' if now is not None else 'the run has ended'}")

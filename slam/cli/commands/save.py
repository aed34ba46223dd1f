"""`wclm save`: saving the map of a live run that goes on."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated

import typer

from ...errors import OutputError


def save(
    out: Annotated[Path, typer.Argument(metavar="DIR", help="Output directory of a `wclm live` that is running.")],
) -> None:
    """Save the map of a live run now; the run goes on.

    A live run also saves its map every 45 seconds, if the key s is pressed in its terminal, and on SIGUSR1.

    Example: [bold]wclm save map[/bold]
    """
    from ..live_requests import find_run, send_request

    answer = send_request(out, find_run(out), signal.SIGUSR1, lambda control: control.saves)
    if answer is not None and answer.save_problem:
        raise OutputError(answer.save_problem)
    typer.echo(f"{out}: {'saved' if answer is not None else 'the run has ended'}")

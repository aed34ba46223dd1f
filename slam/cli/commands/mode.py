"""`wclm mode`: switching a live run between mapping and localisation."""

from __future__ import annotations

import signal
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ...errors import OutputError


class Mode(StrEnum):
    """What a live run does with its map."""

    MAPPING = "mapping"
    LOCALIZATION = "localization"


def mode(
    out: Annotated[Path, typer.Argument(metavar="DIR", help="Output directory of a `wclm live` that is running.")],
    wanted: Annotated[
        Mode | None,
        typer.Argument(
            metavar="mapping|localization", show_default=False, help="Mode from now on; by default only print it."
        ),
    ] = None,
) -> None:
    """Switch a live run between mapping and localisation; the run goes on.

    With `localization` the map stays as it is, and only the pose in it is estimated. With `mapping` it is extended,
    from where the robot is. The mode also changes if the key l is pressed in the terminal of the run, and on SIGUSR2.

    Example: [bold]wclm mode map localization[/bold]
    """
    from ..live_requests import find_run, send_request

    before = find_run(out)
    if wanted is not None and before.frozen != (wanted is Mode.LOCALIZATION):
        answer = send_request(out, before, signal.SIGUSR2, lambda control: control.switches)
        if answer is None:
            raise OutputError(f"{out}: the run has ended")
        if answer.switch_problem:
            raise OutputError(f"{out}: {answer.switch_problem}")
        before = answer
    typer.echo(f"{out}: {Mode.LOCALIZATION if before.frozen else Mode.MAPPING}")

"""`wclm correct`: manual corrections of a session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..console import print_if_slow
from ..options import OverwriteOption

if TYPE_CHECKING:
    from ...io.sessions.corrections import Correction


def correct(
    session: Annotated[Path, typer.Argument(help="Output directory of `wclm run`; changed unless --out is given.")],
    tie: Annotated[
        list[str] | None,
        typer.Option("--tie", metavar="WALL,WALL", help="Two walls are one; it keeps the first identity. Repeatable."),
    ] = None,
    delete_wall: Annotated[
        list[int] | None,
        typer.Option("--delete-wall", metavar="WALL", min=0, help="Wall that is none: it is left out. Repeatable."),
    ] = None,
    pins: Annotated[
        Path | None,
        typer.Option("--pins", metavar="FILE.csv", help="Surveyed coordinates of poses and walls, with covariances."),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="List the corrections.")] = False,
    undo: Annotated[bool, typer.Option("--undo", help="Undo the last correction.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Output directory; SESSION stays as it is.")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Correct a session by hand: tie or delete walls, or pin poses and walls to surveyed coordinates.

    The graph is solved again, and all results are written anew. The session keeps the results before the first
    correction, so corrections can be undone, the last one first. Pins that contradict the others and the map are left
    out and named.

    Example: [bold]wclm correct results/office --pins survey.csv[/bold]
    """
    from ...io.sessions.corrections import read_corrections

    new = _stated(tie or (), delete_wall or (), pins)
    if listed + undo + bool(new) != 1:
        raise typer.BadParameter("state corrections, --list or --undo")
    present = read_corrections(session)
    if listed:
        typer.echo("\n".join(f"{k}: {one.text}" for k, one in enumerate(present, 1)) or "no corrections")
        return
    if undo and not present:
        raise typer.BadParameter(f"{session} has no corrections", param_hint="--undo")
    from .correct_session import write_corrected_session

    with print_if_slow("correcting the session"):
        lines = write_corrected_session(session, present[:-1] if undo else [*present, *new], out, overwrite=overwrite)
    if undo:
        lines = [f"undone: {present[-1].text}", *lines]
    typer.echo("\n".join(lines))


def _stated(ties: list[str] | tuple[()], deletions: list[int] | tuple[()], pins: Path | None) -> list[Correction]:
    """Return the corrections that the options state."""
    from ...io.pins_csv import read_pins
    from ...io.sessions.corrections import WallDeletion, WallTie

    return [
        *(WallTie(walls=_pair(text)) for text in ties),
        *(WallDeletion(wall=wall) for wall in deletions),
        *([read_pins(pins)] if pins is not None else []),
    ]


def _pair(text: str) -> tuple[int, int]:
    """Return the two walls that an option names; raises BadParameter if it is not two identities."""
    parts = text.split(",")
    if len(parts) != 2 or not all(part.strip().isdecimal() for part in parts):
        raise typer.BadParameter(f"{text}: must be two identities of walls, e.g. 12,40", param_hint="--tie")
    return int(parts[0]), int(parts[1])

"""`wclm correct`: manual corrections of a session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.elapsed import parse_elapsed

from ..console import print_if_slow
from ..options import OverwriteOption

if TYPE_CHECKING:
    from ...io.sessions.corrections import Correction, Place


def correct(
    session: Annotated[
        Path, typer.Argument(metavar="SESSION", help="Output directory of `wclm run`; changed unless --out is given.")
    ],
    close: Annotated[
        list[str] | None,
        typer.Option(
            "--close",
            metavar="LOOP|PLACE,PLACE",
            help="Close a loop of the report that was not closed, or where two places are one: keyframes (12,340), "
            "times since the start (0:08,1:36) or stamps (8.5s,96.2s). Refused if the scans do not fit. Repeatable.",
        ),
    ] = None,
    forbid_loop: Annotated[
        list[int] | None,
        typer.Option(
            "--forbid-loop", metavar="LOOP", min=0, help="Closed loop of the report that is wrong. Repeatable."
        ),
    ] = None,
    tie: Annotated[
        list[str] | None,
        typer.Option("--tie", metavar="WALL,WALL", help="Two walls are one; it keeps the first identity. Repeatable."),
    ] = None,
    delete_wall: Annotated[
        list[int] | None,
        typer.Option("--delete-wall", metavar="WALL", min=0, help="Wall that does not exist; left out. Repeatable."),
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
    """Correct a session by hand: close or forbid loops, tie or delete walls, or pin the map to surveyed coordinates.

    The graph is solved again, and all results are written anew. The session keeps the results before the first
    correction, so corrections can be undone, the last one first. Pins that contradict the others and the map are left
    out and named.

    Example: [bold]wclm correct results/office --pins survey.csv[/bold]
    """
    from ...io.run_results import read_run_results
    from ...io.sessions.corrections import read_corrections

    new = [*_stated_loops(session, forbid_loop or (), close or ()), *_stated(tie or (), delete_wall or (), pins)]
    if listed + undo + bool(new) != 1:
        raise typer.BadParameter("state corrections, --list or --undo")
    if listed or undo:
        read_run_results(session)  # another directory has no corrections either, but that is no answer
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


def _stated_loops(session: Path, forbidden: list[int] | tuple[()], closings: list[str] | tuple[()]) -> list[Correction]:
    """Return the corrections of loops that the options state."""
    from ...io.sessions.corrections import LoopForbidding, PlaceClosing, ProposedClosing

    corrections: list[Correction] = [LoopForbidding(loop=number) for number in forbidden]
    for text in closings:
        parts = [part.strip() for part in text.split(",")]
        if len(parts) == 1 and _is_identity(parts[0]):
            corrections.append(ProposedClosing(loop=int(parts[0])))
        elif len(parts) == 2:
            first, second = (_place(session, part, text) for part in parts)
            corrections.append(PlaceClosing(places=(first, second)))
        else:
            raise _not_places(text)
    return corrections


def _place(session: Path, part: str, text: str) -> Place:
    """Return the place that a part of an option names.

    Raises BadParameter if it is neither keyframe, time nor stamp, and MapError if the session has no trajectory.
    """
    from ...io.sessions.corrections import Place

    try:
        if ":" in part:
            return Place(stamp=_start(session) + parse_elapsed(part))
        return Place(stamp=float(part[:-1])) if part.endswith("s") else Place(keyframe=int(part))
    except ValueError as error:
        raise _not_places(text) from error


def _start(session: Path) -> float:
    """Return the stamp (seconds) from which the times of a session are counted. Raises MapError."""
    from ...io.run_results import read_run_results

    return float(read_run_results(session).trajectory.stamps[0])


def _not_places(text: str) -> typer.BadParameter:
    message = "must be the number of a loop, or two keyframes as 12,340, times as 0:08,1:36 or stamps as 8.5s,96.2s"
    return typer.BadParameter(f"{text}: {message}", param_hint="--close")


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
    if len(parts) != 2 or not all(_is_identity(part.strip()) for part in parts):
        raise typer.BadParameter(f"{text}: must be two identities of walls, e.g. 12,40", param_hint="--tie")
    return int(parts[0]), int(parts[1])


def _is_identity(text: str) -> bool:
    """Return True if a text is the number of a loop or wall: Python reads no integer of more than 4300 digits."""
    return text.isdecimal() and len(text) < 10

"""`wclm correct`: manual corrections of a session."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from drivers.elapsed import parse_elapsed

from ..console import print_if_slow
from ..options import OverwriteOption


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
    from ...session_correction import correct as correct_session
    from ...session_correction import undo_correction

    stated = [*(close or ()), *(forbid_loop or ()), *(tie or ()), *(delete_wall or ()), *([pins] if pins else [])]
    if listed + undo + bool(stated) != 1:
        raise typer.BadParameter("state corrections, --list or --undo")
    if listed or undo:
        read_run_results(session)  # another directory has no corrections either, but that is no answer
    if listed:
        texts = [f"{k}: {one.text}" for k, one in enumerate(read_corrections(session), 1)]
        typer.echo("\n".join(texts) or "no corrections")
        return
    if undo and not read_corrections(session):
        raise typer.BadParameter(f"{session} has no corrections", param_hint="--undo")
    with print_if_slow("correcting the session"):
        if undo:
            lines = undo_correction(session, out=out, overwrite=overwrite)
        else:
            lines = correct_session(
                session,
                close=[_closing(session, text) for text in close or ()],
                forbid_loop=forbid_loop or (),
                tie=[_walls(text) for text in tie or ()],
                delete_wall=delete_wall or (),
                pins=pins,
                out=out,
                overwrite=overwrite,
            )
    typer.echo("\n".join(lines))


def _closing(session: Path, text: str) -> int | tuple[float, float]:
    """Return what an option closes: the number of a loop, or two places as keyframes or stamps (seconds)."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) == 1 and _is_identity(parts[0]):
        return int(parts[0])
    if len(parts) != 2:
        raise _not_places(text)
    return _place(session, parts[0], text), _place(session, parts[1], text)


def _place(session: Path, part: str, text: str) -> float:
    """Return the place that a part of an option names: the whole number of a keyframe, or a stamp, as a float.

    Raises BadParameter if it is neither keyframe, time nor stamp, and MapError if the session has no trajectory.
    """
    if _is_identity(part):
        return int(part)
    try:
        if ":" in part:
            return _start(session) + parse_elapsed(part)
        if part.endswith("s") and math.isfinite(stamp := float(part[:-1])):
            return stamp
    except ValueError as error:
        raise _not_places(text) from error
    raise _not_places(text)


def _start(session: Path) -> float:
    """Return the stamp (seconds) from which the times of a session are counted. Raises MapError."""
    from ...io.run_results import read_run_results

    return float(read_run_results(session).trajectory.stamps[0])


def _not_places(text: str) -> typer.BadParameter:
    message = "must be the number of a loop, or two keyframes as 12,340, times as 0:08,1:36 or stamps as 8.5s,96.2s"
    return typer.BadParameter(f"{text}: {message}", param_hint="--close")


def _walls(text: str) -> tuple[int, int]:
    """Return the two walls that an option names; raises BadParameter if it is not two identities."""
    parts = text.split(",")
    if len(parts) != 2 or not all(_is_identity(part.strip()) for part in parts):
        raise typer.BadParameter(f"{text}: must be two identities of walls, e.g. 12,40", param_hint="--tie")
    return int(parts[0]), int(parts[1])


def _is_identity(text: str) -> bool:
    """Return True if a text is the number of a loop or wall: Python reads no integer of more than 4300 digits."""
    return text.isdecimal() and len(text) < 10

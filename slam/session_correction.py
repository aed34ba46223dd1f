"""Corrections of a stored map by hand: `slam.correct` and `wclm correct`."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from numbers import Integral, Real
from operator import index
from pathlib import Path
from typing import Any, SupportsIndex

from drivers.arguments import check_items, check_type, path_of

from .bounds import MAX_MAGNITUDE
from .errors import ArgumentError, MapError
from .formatting import counted
from .io.output_dir import (
    CONFIG,
    DEMO_RESULTS,
    EXPORTS,
    KEYFRAMES,
    MAP,
    PICTURE,
    PLAN_RESULTS,
    SESSION,
    SUMMARY,
    TRAJECTORY,
    OutputDirectory,
)
from .io.pins_csv import read_pins
from .io.run_results import read_run_results, write_results
from .io.sessions import read_session, write_session
from .io.sessions.corrections import (
    MAX_IDENTITY,
    UNCORRECTED,
    Correction,
    LoopForbidding,
    Place,
    PlaceClosing,
    ProposedClosing,
    WallDeletion,
    WallTie,
    read_corrections,
    uncorrected,
    write_corrections,
)
from .offline.corrections import CorrectedSession, correct_session
from .reporting.run_statistics import loop_counts, part_rows
from .reporting.summary import summary_of_changed_map
from .visualisation.report_page import check_page, write_report_page

FILES = (TRAJECTORY, KEYFRAMES, MAP, CONFIG, SUMMARY)
"""Results that depend on corrections, besides the session."""
UNIQUE = PLAN_RESULTS | DEMO_RESULTS | {PICTURE}
"""Results that only the run can make: they are kept with those before the corrections, and restored with them."""
LOGS = "review*.rrd"
"""Review logs: they show the run, without corrections."""


def correct(
    session: Path | str,
    *,
    close: Sequence[int | tuple[float, float]] = (),
    forbid_loop: Sequence[int] = (),
    tie: Sequence[tuple[int, int]] = (),
    delete_wall: Sequence[int] = (),
    pins: Path | str | None = None,
    out: Path | str | None = None,
    overwrite: bool = False,
) -> list[str]:
    """Correct a stored map by hand, as `wclm correct` does with the options of the same names.

    session      output directory of a run, which is changed unless `out` is given
    close        loops that were not closed, by their numbers, and pairs of places that are one: whole numbers are
                 keyframes, as in (12, 340), others stamps in seconds, as in (8.5, 96.25)
    forbid_loop  numbers of closed loops that are wrong
    tie          pairs of walls that are one, which keeps the first identity
    delete_wall  identities of walls that do not exist
    pins         CSV file with surveyed coordinates of poses and walls
    out          output directory of the corrected map; `session` stays as it is then
    overwrite    replace `out` if it exists

    Corrections are added to those that the map has. Returns what was changed, as lines of text; `corrections` in
    summary.json has the figures. Raises SlamError if a correction is impossible; then nothing is changed.
    """
    path = path_of("session", session)
    for name, stated in (("close", close), ("forbid_loop", forbid_loop), ("tie", tie), ("delete_wall", delete_wall)):
        check_items(name, stated, object, "corrections")
    new: list[Correction] = [
        *(LoopForbidding(loop=_identity("forbid_loop", loop)) for loop in forbid_loop),
        *(_closing(one) for one in close),
        *(_tie(walls) for walls in tie),
        *(WallDeletion(wall=_identity("delete_wall", wall)) for wall in delete_wall),
        *(() if pins is None else (read_pins(path_of("pins", pins)),)),
    ]
    if not new:
        raise ArgumentError("no correction is stated")
    return _write(path, [*read_corrections(path), *new], out, overwrite=overwrite)


def undo_correction(session: Path | str, *, out: Path | str | None = None, overwrite: bool = False) -> list[str]:
    """Undo the last correction of a stored map, as `wclm correct --undo` does; for the arguments see `correct`."""
    path = path_of("session", session)
    present = read_corrections(path)
    if not present:
        raise MapError(f"{path}: has no corrections")
    return [f"undone: {present[-1].text}", *_write(path, present[:-1], out, overwrite=overwrite)]


def _closing(stated: int | tuple[float, float]) -> Correction:
    """Return the closing of a loop, or of two places."""
    if isinstance(stated, Integral):
        return ProposedClosing(loop=_identity("close", stated))
    first, second = _pair("close", stated)
    return PlaceClosing(places=(_place(first), _place(second)))


def _place(stated: float) -> Place:
    """Return the place at a keyframe or a stamp."""
    if isinstance(stated, Integral):
        return Place(keyframe=_identity("close", stated))
    check_type("close", stated, Real, "numbers")
    if not abs(stated) < MAX_MAGNITUDE:
        raise ArgumentError(f"close: {stated} is no stamp")
    return Place(stamp=float(stated))


def _tie(stated: tuple[int, int]) -> Correction:
    kept, absorbed = _pair("tie", stated)
    return WallTie(walls=(_identity("tie", kept), _identity("tie", absorbed)))


def _pair(name: str, stated: object) -> tuple[Any, Any]:
    """Return both parts of a pair."""
    if isinstance(stated, str) or not isinstance(stated, Sequence) or len(stated) != 2:
        raise ArgumentError(f"{name}: {stated!r} is no pair")
    return stated[0], stated[1]


def _identity(name: str, stated: SupportsIndex) -> int:
    """Return the number of a loop, a wall or a keyframe, of Python or NumPy."""
    check_type(name, stated, Integral, "whole numbers")
    if not 0 <= (number := index(stated)) < MAX_IDENTITY:
        raise ArgumentError(f"{name}: there is no {number}")
    return number


def _write(path: Path, corrections: Sequence[Correction], out: Path | str | None, *, overwrite: bool) -> list[str]:
    """Apply all corrections to the uncorrected session and write the results, in its place if `out` is None.

    Without any, the results are those before the first correction, byte for byte. Returns lines of text. Raises
    SlamError; then nothing is changed.
    """
    base, target = uncorrected(path), path if out is None else path_of("out", out)
    results = read_run_results(base)
    check_page(results)  # the new page shows parts of its summary
    session = read_session(base)
    exported = sorted(name for name in EXPORTS | UNIQUE if (target / name).exists())
    with OutputDirectory(target, overwrite or out is None) as directory:
        for log in sorted(path.glob(LOGS)):
            shutil.copy2(log, directory)
        if corrections:
            corrected = correct_session(session, results.trajectory, corrections)
            write_results(directory, corrected.finished, session.config, _summary(results.summary, corrected))
            write_session(directory, corrected.session)
            _copy_results(base, directory / SESSION / UNCORRECTED)
            write_corrections(directory, list(corrections))
        else:
            _copy_results(base, directory)
        stale = [name for name in exported if not (directory / name).exists()]
    write_report_page(target)
    removed = [f"  removed, as they show the map before: {', '.join(stale)}"] if stale else []
    if not corrections:
        return [f"{target}: no corrections", *removed]
    return [f"{target}: {counted(len(corrected.finished.walls), 'wall')}", *_lines(corrected.outcomes), *removed]


def _copy_results(source: Path, directory: Path) -> None:
    """Copy the results that depend on corrections, with the session; `directory` is created if missing."""
    directory.mkdir(exist_ok=True)
    for name in FILES:
        if (source / name).is_file():
            shutil.copy2(source / name, directory)
        elif name != KEYFRAMES:
            raise MapError(f"{source}: has no {name}; expected the output directory of `wclm run`")
    for name in UNIQUE:
        if (source / name).is_file():
            shutil.copy2(source / name, directory)
    shutil.copytree(source / SESSION, directory / SESSION)


def _summary(before: dict[str, Any], corrected: CorrectedSession) -> dict[str, Any]:
    """Return the summary of the run with the figures of the corrected map."""
    finished, slam = corrected.finished, before.get("slam") or {}
    return summary_of_changed_map(before) | {
        "keyframes": len(finished.keyframes),
        "walls": len(finished.walls),
        "corners": len(finished.corners),
        "slam": slam
        | {"suspects": finished.summary["suspects"]}
        | ({"parts": part_rows(corrected.session.slam_state)} if "parts" in slam else {})
        | _loops(slam, corrected.loops),
        "corrections": corrected.outcomes,
    }


def _loops(slam: dict[str, Any], decided: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the loops of a summary's part `slam` with those that corrections decide; empty if there are none."""
    if not decided:
        return {}
    before = slam.get("loop_decisions") or []
    known, numbers = {row["candidate"]: row for row in before}, {row["candidate"] for row in decided}
    rows = [row for row in before if row["candidate"] not in numbers]
    rows += [known.get(row["candidate"], {}) | row for row in decided]
    decisions = sorted(rows, key=lambda row: float(row["stamp"]))
    return {"loop_decisions": decisions, "loops": loop_counts(decisions)}


def _lines(outcomes: Sequence[dict[str, Any]]) -> list[str]:
    """Return the corrections with their outcomes as lines of text."""
    from .visualisation.report_page.correction_text import outcome_lines

    return [
        f"  {k}: {outcome['text']}" + "".join(f"\n     {line}" for line in outcome_lines(outcome))
        for k, outcome in enumerate(outcomes, 1)
    ]

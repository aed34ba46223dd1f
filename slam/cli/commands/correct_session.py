"""Write the results of a session with corrections."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...errors import MapError
from ...formatting import counted
from ...io.output_dir import (
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
from ...io.run_results import read_run_results, write_results
from ...io.sessions import read_session, write_session
from ...io.sessions.corrections import UNCORRECTED, Correction, uncorrected, write_corrections
from ...offline.corrections import CorrectedSession, correct_session
from ...reporting.run_statistics import loop_counts, part_rows
from ...reporting.summary import summary_of_changed_map
from ...visualisation.report_page import check_page
from ..slam_run import write_report_page

FILES = (TRAJECTORY, KEYFRAMES, MAP, CONFIG, SUMMARY)
"""Results that depend on corrections, besides the session."""
UNIQUE = PLAN_RESULTS | DEMO_RESULTS | {PICTURE}
"""Results that only the run can make: they are kept with those before the corrections, and restored with them."""
LOGS = "review*.rrd"
"""Review logs: they show the run, without corrections."""


def write_corrected_session(
    path: Path, corrections: Sequence[Correction], out: Path | None, *, overwrite: bool
) -> list[str]:
    """Apply all corrections to the uncorrected session and write the results, in its place if `out` is None.

    Without any, the results are those before the first correction, byte for byte. Returns lines of text. Raises
    SlamError; then nothing is changed.
    """
    base, target = uncorrected(path), out or path
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
    from ...visualisation.report_page.correction_text import outcome_lines

    return [
        f"  {k}: {outcome['text']}" + "".join(f"\n     {line}" for line in outcome_lines(outcome))
        for k, outcome in enumerate(outcomes, 1)
    ]

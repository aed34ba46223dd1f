"""`wclm merge`: one map from several sessions."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..console import print_if_slow
from ..options import OutOption, OverwriteOption, PlotOption, ReviewOption

if TYPE_CHECKING:
    from ...events import Finished, Sink
    from ...offline.map_merging import MergedSession
    from ..run_summary import RunResult

MIN_SESSIONS = 2


def merge(
    sessions: Annotated[
        list[Path], typer.Argument(metavar="SESSION", help="Output directories of two or more runs in one building.")
    ],
    out: OutOption,
    overwrite: OverwriteOption = False,
    review: ReviewOption = True,
    plot: PlotOption = False,
) -> None:
    """Merge sessions of one building into one map, in the frame of the first session.

    Each session is searched for in the map of the sessions before it. It is merged if it fits in one place only, then
    the whole map is refined. An error if a session fits nowhere or in several places.

    Example: [bold]wclm merge maps/monday maps/tuesday --out maps/both[/bold]
    """
    from ..run_summary import format_summary

    if len(sessions) < MIN_SESSIONS:
        raise typer.BadParameter("at least two sessions are required", param_hint="SESSION")
    result = _merge(sessions, out, overwrite=overwrite, review=review, picture=plot)
    head, *rows = format_summary(result, out)
    joined_rows = [f"  {'joined':<11}{joined['session']}: {joined['reason']}" for joined in result.summary["joined"]]
    typer.echo("\n".join([head, *joined_rows, *rows]))


def _merge(paths: list[Path], out: Path, *, overwrite: bool, review: bool, picture: bool) -> RunResult:
    """Merge the sessions into a new one. Raises SlamError; then nothing is left behind."""
    from ...io.output_dir import PICTURE, OutputDirectory
    from ...io.run_results import write_results
    from ...visualisation.report_page import write_report_page
    from ..run_summary import RunResult
    from ..setup_from_options import READING_SESSION
    from ..slam_run import review_log

    with OutputDirectory(out, overwrite) as directory, ExitStack() as log:
        from ...events import Notice
        from ...io.sessions import read_session, write_session
        from ...offline.map_merging import merge_sessions
        from ...offline.optimisation import optimise
        from ...reporting.publisher import Publisher
        from ...warmup import warm_up

        started = time.perf_counter()
        with print_if_slow(READING_SESSION):
            warm_up()
            sessions = [(str(path), read_session(path)) for path in paths]
        joined = merge_sessions(sessions)
        config, name = joined.session.config, " + ".join(some.name for some in joined.session.recordings)
        sinks: list[Sink] = [log.enter_context(review_log(directory, config, name, complete=True))] if review else []
        optimised = optimise(joined.session, sinks)
        for path, location in joined.added:
            text = f"joined with {path}: {location.reason}"
            Publisher(sinks).publish(Notice(joined.session.scans[-1].stamp, text, "INFO"))
        log.close()
        finished = optimised.finished
        summary = _summarise(name, joined, finished, time.perf_counter() - started)
        if picture:
            from ...io.drives import split_drives
            from ...io.tum import Trajectory
            from ...visualisation.plots import plot_map

            drives = split_drives(Trajectory(finished.stamps, finished.poses), summary["recordings"])
            plot_map(directory / PICTURE, finished.walls, finished.corners, drives, title=name)
        write_results(directory, finished, config, summary)
        write_session(directory, optimised.session)
    write_report_page(out)
    return RunResult(summary, review)


def _summarise(name: str, joined: MergedSession, finished: Finished, seconds: float) -> dict[str, Any]:
    """Return the summary: entries as of a run, and how each session was located."""
    from ...reporting.run_statistics import loop_counts
    from ...reporting.summary import RunTimes, summarise
    from ..run_summary import path_length

    session = joined.session
    decisions = [dict(decision) for decision in session.loop_decisions]
    summary = summarise(
        finished,
        recording=name,
        recording_path=None,
        scans=len(session.scans),
        odometry=sum(len(history) for history in session.odometry),
        duration=sum(one.last - one.first for one in session.recordings),
        path_length=sum(path_length(finished, one.first, one.last) for one in session.recordings),
        times=RunTimes(seconds, seconds),
        warnings=joined.warnings,
    )
    return summary | {
        "slam": summary["slam"] | {"loops": loop_counts(decisions), "loop_decisions": decisions},
        "recordings": [recording.model_dump() for recording in session.recordings],
        "joined": [
            {
                "session": path,
                "submaps": found.submaps,
                "placed": len(found.members),
                "evidence": found.evidence,
                "required": found.required,
                "reason": found.reason,
            }
            for path, found in joined.added
        ],
    }

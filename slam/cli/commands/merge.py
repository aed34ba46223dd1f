"""`wclm merge`: one map of several sessions."""

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
    from ...io.sessions import Recording
    from ...offline.map_merging import Joined
    from ..run_summary import RunResult

MIN_SESSIONS = 2


def merge(
    sessions: Annotated[
        list[Path], typer.Argument(metavar="SESSION SESSION...", help="Directories that runs in one building left.")
    ],
    out: OutOption,
    overwrite: OverwriteOption = False,
    review: ReviewOption = True,
    plot: PlotOption = False,
) -> None:
    """Make one map of several sessions, in the frame of the first; where they lie in each other is found out.

    Places of each session are looked for in the map of those before it. Only where several of them agree is it joined,
    and everything is looked at again then. Sessions that do not recognise each other are refused.

    Example: [bold]wclm merge maps/monday maps/tuesday --out maps/both[/bold]
    """
    from ..run_summary import format_summary

    if len(sessions) < MIN_SESSIONS:
        raise typer.BadParameter("name two or more", param_hint="SESSION SESSION...")
    result = _merge(sessions, out, overwrite=overwrite, review=review, picture=plot)
    head, *rows = format_summary(result, out)
    told = [f"  {'joined':<11}{joined['session']}: {joined['reason']}" for joined in result.summary["joined"]]
    typer.echo("\n".join([head, *told, *rows]))


def _merge(paths: list[Path], out: Path, *, overwrite: bool, review: bool, picture: bool) -> RunResult:
    """Join the sessions and write another. Raises SlamError; then nothing is left behind."""
    from ...io.output_dir import PICTURE, OutputDirectory, write_results
    from ..run_summary import RunResult
    from ..slam_run import READING_SESSION, review_log, write_report_page

    with OutputDirectory(out, overwrite) as directory, ExitStack() as log:
        from ...io.sessions import read_session, write_session
        from ...offline.map_merging import join
        from ...optimisation import optimise
        from ...warmup import warm_up

        started = time.perf_counter()
        with print_if_slow(READING_SESSION):
            warm_up()
            sessions = [(str(path), read_session(path)) for path in paths]
        joined = join(sessions)
        config, name = joined.session.config, " + ".join(some.name for some in joined.session.recordings)
        sinks: list[Sink] = [log.enter_context(review_log(directory, config, name))] if review else []
        optimised = optimise(joined.session, sinks)
        log.close()
        finished = optimised.finished
        if picture:
            from ...visualisation.plots import plot_map

            plot_map(directory / PICTURE, finished.lines, finished.corners, finished.poses, title=name)
        summary = _summarise(name, joined, finished, time.perf_counter() - started)
        write_results(directory, finished, config, summary)
        write_session(directory, optimised.session)
    write_report_page(out)
    return RunResult(summary, review)


def _summarise(name: str, joined: Joined, finished: Finished, seconds: float) -> dict[str, Any]:
    """The summary of a run, as far as there was one, and how each session was found."""
    from ...io.host import peak_memory, versions

    session = joined.session
    duration = sum(recording.last - recording.first for recording in session.recordings)
    return {
        "recording": name,
        "recording_path": None,
        "recordings": [recording.model_dump() for recording in session.recordings],
        "joined": [
            {
                "session": path,
                "pieces": found.looked_for,
                "recognised": found.recognised,
                "agree": len(found.members),
                "independent": found.independent,
                "reason": found.reason,
            }
            for path, found in joined.found
        ],
        "seed": None,
        "scans": len(session.scans),
        "odometry": sum(len(history) for history in session.odometry),
        "duration": duration,
        "keyframes": len(finished.keyframes),
        "walls": len(finished.lines),
        "corners": len(finished.corners),
        "path_length": sum(_driven(finished, recording) for recording in session.recordings),
        "slam_seconds": seconds,
        "wall_seconds": seconds,
        "real_time_factor": duration / seconds,
        "peak_memory_mib": peak_memory(),
        "truth": None,
        "warnings": [],
        "skipped": {"messages": 0, "reasons": {}, "first": None},
        "slam": finished.summary,
        "versions": versions(),
    }


def _driven(finished: Finished, recording: Recording) -> float:
    """Metres driven in a recording; between two, the robot was carried."""
    from ...io.tum import Trajectory

    own = (finished.stamps >= recording.first) & (finished.stamps <= recording.last)
    return float(Trajectory(finished.stamps[own], finished.poses[own]).travelled[-1]) if own.any() else 0.0

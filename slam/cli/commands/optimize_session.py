"""`wclm optimize` of a session, or of a recording, which is mapped first."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.immutable import immutable

from ...config import Config
from ...errors import MapError
from ...formatting import counted
from ...io.host import peak_memory
from ...io.output_dir import PICTURE, OutputDirectory
from ...io.recordings import open_to_map, recording_to_reopen
from ...io.run_results import write_results
from ...reporting.input_statistics import InputStatistics
from ...reporting.notice_collector import NoticeCollector
from ...run_setup import RunSetup
from ..compilation import compile_for_recording
from ..console import print_if_slow
from ..run_input import RecordingInput, recording_entry
from ..run_summary import RunResult, check_summary, format_summary
from ..setup_from_options import READING_SESSION, without_odometry
from ..slam_run import process_messages, review_log

if TYPE_CHECKING:
    from ...events import Event, Sink
    from ...io.sessions import StoredSession
    from ...visualisation.rerun_log import ReviewLog

SHOWN_SHIFTS = 3
"""Number of largest keyframe shifts that are listed."""
MAX_WAITING = 100
"""Number of waiting events of the review log above which the run is delayed."""
PAUSE = 0.01
"""Seconds between two checks of the number of waiting events."""


class BlockingSink:
    """Sink of a review log that blocks instead of dropping events, as offline nothing is in a hurry."""

    def __init__(self, log: ReviewLog) -> None:
        self._log = log

    def handle(self, event: Event) -> None:
        """Process one event, once most of those before it are written."""
        while self._log.waiting > MAX_WAITING:
            time.sleep(PAUSE)
        self._log.handle(event)


def optimize_session(path: Path, out: Path, *, overwrite: bool, review: bool, picture: bool) -> list[str]:
    """Refine the session in an output directory and write another; return its summary as lines of text.

    Raises SlamError; then nothing is left behind.
    """
    with OutputDirectory(out, overwrite) as directory:
        from ...io.run_results import read_run_results
        from ...io.sessions import read_session
        from ...io.sessions.corrections import read_corrections

        started = time.perf_counter()
        results = read_run_results(path)
        check_summary(results)  # the new run has parts of it
        if read_corrections(path):
            raise MapError(f"{path}: has manual corrections, which a refinement would drop; refine before correcting")
        with print_if_slow(READING_SESSION):
            session = read_session(path)
        mapped = _Mapped(str(path), session, results.config(), results.summary)
        summary = _optimise(directory, mapped, started, review=review, picture=picture)
    return _report(summary, out, review=review)


def optimize_recording(
    recording: str, config: Config, out: Path, *, overwrite: bool, review: bool, picture: bool
) -> list[str]:
    """Map a recording and refine it; otherwise like `optimize_session`."""
    from ...reporting.summary import RunTimes
    from ..run_summary import summarise_run

    with OutputDirectory(out, overwrite) as directory:
        from ...pipeline import Slam

        compile_for_recording()
        source, reason = open_to_map(recording, config)
        setup = RunSetup(config) if reason is None else without_odometry(RunSetup(config), f"{source.name}: {reason}")
        run_input = RecordingInput(source, reopen=recording_to_reopen(recording))
        notices, statistics = NoticeCollector(), InputStatistics()
        started = time.perf_counter()
        with run_input.opened(lambda: None) as messages:
            slam = Slam(run_input.resolve(setup.config), [notices], keep_all_features=True)
            finished, busy = process_messages(statistics.read(messages), slam, run_input.name)
        took = time.perf_counter() - started
        summary = summarise_run(
            run_input, finished, statistics, notices.texts, None, seed=None, times=RunTimes(busy, took)
        ) | {"lidars": [mount.tolist() for mount in slam.lidar_mounts]}
        session = slam.session
        session.recordings.append(recording_entry(run_input, statistics, slam.config, slam.lidar_mounts))
        started = time.perf_counter()
        mapped = _Mapped(recording, session, setup.config, summary)
        summary = _optimise(directory, mapped, started, review=review, picture=picture)
    return _report(summary, out, review=review)


@immutable
class _Mapped:
    """A run that is to be refined.

    source   where it comes from, for messages
    session  its session
    config   settings, without what the recording shows of the lidars
    summary  its summary
    """

    source: str
    session: StoredSession
    config: Config
    summary: dict[str, Any]


def _optimise(directory: Path, mapped: _Mapped, started: float, *, review: bool, picture: bool) -> dict[str, Any]:
    """Refine a run into a directory; return its summary with the new figures.

    Raises MapError that names the source.
    """
    from ...io.sessions import write_session
    from ...offline.optimisation import optimise
    from ...reporting.summary import summary_of_changed_map

    session, summary = mapped.session, mapped.summary
    with ExitStack() as log:
        sinks: list[Sink] = []
        if review:
            written = review_log(directory, session.config, str(summary.get("recording", "")), complete=True)
            sinks.append(BlockingSink(log.enter_context(written)))
        try:
            optimised = optimise(session, sinks)
        except MapError as error:
            raise MapError(f"{mapped.source}: {error}") from error
    finished = optimised.finished
    summary = summary_of_changed_map(summary) | {
        "keyframes": len(finished.keyframes),
        "walls": len(finished.walls),
        "corners": len(finished.corners),
        "recordings": [recording.model_dump() for recording in session.recordings],
        "slam": (summary.get("slam") or {})
        | {"refinement": optimised.summary, "factors": optimised.summary["factors_after"]}
        | {"suspects": finished.summary["suspects"]},
        "optimisation_seconds": time.perf_counter() - started,
        "peak_memory_mib": peak_memory(),
    }
    if picture:
        from ...io.drives import split_drives
        from ...io.tum import Trajectory
        from ...visualisation.plots import plot_map

        drives = split_drives(Trajectory(finished.stamps, finished.poses), summary["recordings"])
        title = f"{summary.get('recording', '')}, optimised"
        plot_map(directory / PICTURE, finished.walls, finished.corners, drives, title=title)
    write_results(directory, finished, mapped.config, summary)
    write_session(directory, optimised.session)
    return summary


def _report(summary: dict[str, Any], out: Path, *, review: bool) -> list[str]:
    """Write the report page; return the lines of the run's summary, with the changes instead of the time."""
    from ...visualisation.report_page import write_report_page

    write_report_page(out)
    changed = summary["slam"]["refinement"]
    head, first, _, *others = format_summary(RunResult(summary, review), out)
    rows = [
        ("before", f"{changed['factors_before']} factors, cost {changed['cost_before']:.6g}"),
        ("after", f"{changed['factors_after']} factors, cost {changed['cost_after']:.6g}{_comparable(changed)}"),
        (
            "changed",
            f"{counted(changed['associations_changed'], 'association')}, "
            f"{counted(changed['walls_merged'], 'wall')} merged, in {counted(changed['iterations'], 'iteration')}",
        ),
        ("moved", _moved(changed)),
        ("time", f"{summary['optimisation_seconds']:.1f} s, {summary['peak_memory_mib']:.0f} MiB"),
    ]
    return [head, first, *(f"  {name:<11}{text}" for name, text in rows), *others]


def _comparable(changed: dict[str, Any]) -> str:
    """Return a remark on costs of different numbers of factors, as the end of a line of text."""
    return (
        ""
        if changed["factors_before"] == changed["factors_after"]
        else "; costs of different factors cannot be compared"
    )


def _moved(changed: dict[str, Any]) -> str:
    shifts = changed["largest_shifts"][:SHOWN_SHIFTS]
    named = ", ".join(f"{shift['metres']:.3f} m (keyframe {shift['keyframe']})" for shift in shifts)
    return f"keyframes by {changed['median_shift']:.3f} m (median), at most by {named}"

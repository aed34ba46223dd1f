"""One run of SLAM: from the messages of an input to a complete output directory."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import typer

from drivers import se2
from drivers.messages import Message

from ..config import Config, config_to_toml, load_config
from ..errors import MapError
from ..evaluation.metrics import ReferenceScore, score_reference
from ..events import Event, Finished, Notice, Sink
from ..io.host import versions
from ..io.output_dir import CONFIG, PICTURE, REPORT, REVIEW, OutputDirectory, unfinished_file, write_results
from ..io.tum import Trajectory
from .compilation import compile_all
from .console import print_if_slow
from .run_input import InputStatistics, RunInput
from .run_summary import RunResult, summarise_run

if TYPE_CHECKING:
    from ..io.sessions import StoredSession
    from ..pipeline import Slam
    from ..visualisation.plots.style import Floats
    from ..visualisation.rerun_log import ReviewLog, ViewerServer

READING_SESSION = "reading the session"
FINDING_TIMING = "estimating the timing of the lidar"


@dataclass(frozen=True, slots=True, eq=False)
class RunSetup:
    """Initial state of a run.

    config   settings
    resumed  session to continue, if any
    frozen   True to localise on the map of `resumed` without changing it
    """

    config: Config
    resumed: StoredSession | None
    frozen: bool


def prepare_run(
    continued: Path | None, localized: Path | None, config: Path | None, settings: Sequence[str] | None
) -> RunSetup:
    """Load the settings, and the session that `--continue` or `--localize` names.

    Settings come from `config`, else from the session, else from the defaults; `settings` override single ones. Raises
    SlamError if they are invalid, or if the session cannot be read or has no map.
    """
    if continued is not None and localized is not None:
        raise typer.BadParameter("only one of the two can be given", param_hint="--continue / --localize")
    session = continued or localized
    if session is None:
        return RunSetup(load_config(config, settings or ()), None, False)
    from ..io.sessions import read_session

    with print_if_slow(READING_SESSION):
        resumed = read_session(session)
    if not resumed.slam_state.mapper.keyframe_count:
        raise MapError(f"{session}: has no keyframe and cannot be continued")
    return RunSetup(load_config(config or session / CONFIG, settings or ()), resumed, localized is not None)


@dataclass(slots=True)
class NoticeCollector:
    """Sink that collects the texts of notices."""

    handled: ClassVar[tuple[type[Event], ...]] = (Notice,)
    texts: list[str] = field(default_factory=list)

    def handle(self, event: Event) -> None:
        """Process one event."""
        if isinstance(event, Notice):
            self.texts.append(f"{event.text} (at {event.stamp:.2f} s)")


def run_slam(
    run_input: RunInput,
    config: Config,
    out: Path,
    *,
    overwrite: bool,
    review: bool,
    picture: bool,
    refine: bool = False,
    seed: int | None = None,
    resumed: StoredSession | None = None,
    frozen: bool = False,
    server: ViewerServer | None = None,
) -> RunResult:
    """Run SLAM on `run_input` and write the output directory `out`, which appears only when it is complete.

    overwrite  replace an existing output directory
    review     write the review log; viewers can connect to it at `server` during the run
    picture    draw the map
    resumed    session to continue; if `frozen`, its map is only used for localisation and not changed
    seed       of the simulation, for the summary

    Raises SlamError. On any exception nothing is left behind.
    """
    with OutputDirectory(out, overwrite) as directory, ExitStack() as log:
        from ..io.sessions import write_session
        from ..pipeline import Slam

        compile_all()
        gc.freeze()  # otherwise a full collection over all imported modules delays a scan by 0.1 s
        notices, statistics = NoticeCollector(), InputStatistics()
        sinks: list[Sink] = [notices, *run_input.sinks]
        reviewed = None
        if review:
            reviewed = log.enter_context(review_log(directory, config, run_input.name, server, seed))
            sinks.append(reviewed)
        started = time.perf_counter()
        with run_input.opened() as messages:
            with print_if_slow(FINDING_TIMING):
                resolved = run_input.resolve(config)
            slam = Slam(
                resolved, sinks, refine=refine, keep_all_features=run_input.finite, resumed=resumed, frozen=frozen
            )
            after = -np.inf if resumed is None else resumed.latest
            finished, busy = process_messages(_shifted(messages, after, statistics), slam, statistics, run_input.name)
            log.close()
            score = score_against_truth(finished, statistics)
            if picture:
                _draw(directory / PICTURE, finished, statistics, score, run_input.name)
            took = time.perf_counter() - started
            summary = summarise_run(
                run_input, finished, statistics, notices.texts, score, seed=seed, slam_seconds=busy, seconds=took
            )
            session = slam.session
            session.recordings.append(statistics.recording(run_input))
            recordings = session.recordings[-1:] if frozen else session.recordings
            summary["recordings"] = [recording.model_dump() for recording in recordings]
            summary["review"] = None if reviewed is None else reviewed.left_out()
            write_results(directory, finished, config, summary)
            if not frozen:
                write_session(directory, session)
    write_report_page(out)
    return RunResult(summary, review)


def review_log(
    directory: Path, config: Config, name: str, server: ViewerServer | None = None, seed: int | None = None
) -> ReviewLog:
    """Create the review log in an output directory; `name` is that of the recording."""
    from ..visualisation.rerun_log import ReviewLog

    settings = config_to_toml(config)
    return ReviewLog(directory / REVIEW, config=settings, recording=name, versions=versions(), server=server, seed=seed)


def _shifted(messages: Iterable[Message], after: float, statistics: InputStatistics) -> Iterator[Message]:
    """Yield the messages; shift all stamps to later than `after` (seconds) if the first one is earlier than that."""
    for message in messages:
        if statistics.first == np.inf and message.stamp < after:
            statistics.shift = float(np.ceil(after - message.stamp)) + 1.0
        yield replace(message, stamp=message.stamp + statistics.shift) if statistics.shift else message


def process_messages(
    messages: Iterable[Message], slam: Slam, statistics: InputStatistics, name: str
) -> tuple[Finished, float]:
    """Process all messages; return the result and the seconds that the pipeline took.

    Raises MapError with `name`, that of the recording.
    """
    busy = 0.0
    try:
        for message in messages:
            statistics.add(message)
            before = time.perf_counter()
            slam.add(message)
            busy += time.perf_counter() - before
        before = time.perf_counter()
        finished = slam.finish()
        return finished, busy + time.perf_counter() - before
    except MapError as error:
        raise MapError(f"{name}: {error}") from error


def write_report_page(out: Path) -> None:
    """Write the report page of an output directory.

    Called when the other results are in place, so that they are not lost if it fails.
    """
    from ..io.run_results import read_run_results
    from ..visualisation.report_page import write_page

    with unfinished_file(out / REPORT) as unfinished:
        write_page(unfinished, read_run_results(out))


def score_against_truth(finished: Finished, statistics: InputStatistics) -> ReferenceScore | None:
    """Score the path against the ground truth; return None if there is none for the time of the path."""
    if not statistics.truth:
        return None
    truth = Trajectory(np.array(statistics.truth_stamps), np.array(statistics.truth))
    try:
        return score_reference(Trajectory(finished.stamps, finished.poses), truth)
    except MapError:  # no common time
        return None


def _draw(
    path: Path, finished: Finished, statistics: InputStatistics, score: ReferenceScore | None, title: str
) -> None:
    from ..visualisation.plots import plot_map

    odometry: Floats | None = None
    if statistics.odometry:
        poses = np.array(statistics.odometry)
        start = min(int(np.searchsorted(finished.stamps, statistics.first)), len(finished.poses) - 1)
        odometry = se2.compose(finished.poses[start], se2.between(poses[0], poses))
    truth = None if score is None else se2.compose(se2.inverse(score.alignment), score.reference)
    plot_map(path, finished.walls, finished.corners, finished.poses, title=title, odometry=odometry, truth=truth)

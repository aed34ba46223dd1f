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
from ..events import Event, Finished, Notice, Sink
from ..io.host import versions
from ..io.output_dir import CONFIG, REPORT, REVIEW, OutputDirectory, unfinished_file
from .autosave import Autosave
from .compilation import compile_all
from .console import print_if_slow, print_message
from .left_behind import print_left_behind
from .options import parse_pose
from .plan_input import NO_PLAN, PlanOptions, is_plan, load_plan
from .run_input import InputStatistics, RunInput
from .run_summary import RunResult
from .run_writer import RunWriter
from .terminal_keys import TerminalKeys

if TYPE_CHECKING:
    from ..io.sessions import StoredSession
    from ..mapping.plan_map import PlanMap
    from ..pipeline import Slam
    from ..visualisation.live_page import GridLayer, PageServer
    from ..visualisation.rerun_log import ReviewLog, ViewerServer

READING_SESSION = "reading the session"
FINDING_TIMING = "estimating the timing of the lidar"


@dataclass(frozen=True, slots=True, eq=False)
class RunSetup:
    """Initial state of a run.

    config   settings
    resumed  session to continue, if any
    frozen   True to localise on the map of `resumed` without changing it
    pose     roughly known pose of the base in that map, or in the plan, at the beginning; None if it may be anywhere
    plan     plan to map with, if any
    """

    config: Config
    resumed: StoredSession | None
    frozen: bool
    pose: se2.Pose | None = None
    plan: PlanMap | None = None


def prepare_run(
    continued: Path | None,
    localized: Path | None,
    config: Path | None,
    settings: Sequence[str] | None,
    start: str | None = None,
    plan: PlanOptions = NO_PLAN,
) -> RunSetup:
    """Load the settings, and the session or the plan that `--continue`, `--localize` or `--plan` names.

    Settings come from `config`, else from the session, else from the defaults; `settings` override single ones. Raises
    SlamError if they are invalid, or if the session or the plan cannot be read or has no map.
    """
    if continued is not None and localized is not None:
        raise typer.BadParameter("only one of the two can be given", param_hint="--continue / --localize")
    plan.check(continued or localized)
    session, pose = continued or localized, parse_pose(start, "--start")
    if session is None and plan.path is None and pose is not None:
        raise typer.BadParameter("needs a map, by --continue, --localize or --plan", param_hint="--start")
    if session is None or is_plan(session):
        loaded = load_config(config, settings or ())
        if session is None:
            return RunSetup(
                loaded, None, False, pose, None if plan.path is None else load_plan(plan.path, plan, loaded)
            )
        if localized is None:
            raise MapError(f"{session}: is a plan and no session to continue; --plan maps with it")
        from ..io.sessions.plan_session import plan_session

        return RunSetup(loaded, plan_session(load_plan(session, plan, loaded), loaded), True, pose)
    from ..io.sessions import read_session

    with print_if_slow(READING_SESSION):
        resumed = read_session(session, solve=continued is None)
    if not resumed.slam_state.mapper.keyframe_count:
        raise MapError(f"{session}: has no keyframe and cannot be continued")
    return RunSetup(load_config(config or session / CONFIG, settings or ()), resumed, localized is not None, pose)


def without_odometry(start: RunSetup, reason: str) -> RunSetup:
    """Return a setup that maps by the scans alone, and print so; `reason` is why."""
    print_message(f"{reason}: motions are predicted at constant velocity and corrected by the scans")
    odometry = start.config.odometry.model_copy(update={"source": "none"})
    return replace(start, config=start.config.model_copy(update={"odometry": odometry}))


@dataclass(slots=True)
class NoticeCollector:
    """Sink that collects the texts of notices that are warnings."""

    handled: ClassVar[tuple[type[Event], ...]] = (Notice,)
    texts: list[str] = field(default_factory=list)

    def handle(self, event: Event) -> None:
        """Process one event."""
        if isinstance(event, Notice) and event.level == "WARN":
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
    start: se2.Pose | None = None,
    plan: PlanMap | None = None,
    server: ViewerServer | None = None,
    keys: TerminalKeys | None = None,
    page: PageServer | None = None,
) -> RunResult:
    """Run SLAM on `run_input` and write the output directory `out`, which appears only when it is complete.

    overwrite  replace an existing output directory
    review     write the review log; viewers can connect to it at `server` during the run
    picture    draw the map
    resumed    session to continue; if `frozen`, its map is only used for localisation and not changed
    start      roughly known pose of the base in that map, or in the plan, at the beginning
    plan       plan to map with
    seed       of the simulation, for the summary
    keys       keys of the terminal, with the handlers of a live run; the key `s` saves the map
    page       page of a live run, which shows it and saves the map on request

    Raises SlamError. On any exception nothing is left behind, but the last save of a live run stays after an error.
    """
    print_left_behind(out)
    output = OutputDirectory(out, overwrite, reserved=not run_input.finite)
    with output as directory, ExitStack() as log, ExitStack() as saving:
        from ..pipeline import Slam

        compile_all()
        gc.freeze()  # otherwise a full collection over all imported modules delays a scan by 0.1 s
        notices, statistics = NoticeCollector(), InputStatistics()
        sinks: list[Sink] = [notices, *run_input.sinks]
        reviewed = None
        if review:
            written = review_log(directory, config, run_input.name, server, seed, complete=run_input.finite)
            reviewed = log.enter_context(written)
            sinks.append(reviewed)
        started = time.perf_counter()
        writer = RunWriter(run_input, config, statistics, notices.texts, frozen, picture, seed, started, plan)
        keys = keys or TerminalKeys()
        autosave = Autosave(output, lambda: writer.snapshot(slam), keys)
        if page is not None:
            sinks += [page.state, log.enter_context(_grid_layer(page, writer, resumed))]
            _let_page_save(page, autosave)
        with run_input.opened(autosave.poll) as messages:
            with print_if_slow(FINDING_TIMING):
                resolved = run_input.resolve(config)
            slam = Slam(
                resolved,
                sinks,
                refine=refine,
                keep_all_features=run_input.finite,
                resumed=resumed,
                frozen=frozen,
                start=start,
                plan=plan,
            )
            if not run_input.finite:
                saving.enter_context(autosave)
                saving.enter_context(keys)
            after = -np.inf if resumed is None else resumed.latest
            finished, busy = process_messages(_shifted(messages, after, statistics), slam, statistics, run_input.name)
            saving.close()
            log.close()
            left_out = None if reviewed is None else reviewed.left_out()
            summary, write = writer.final(slam, finished, busy, left_out)
            output.finish(write)
    write_report_page(out)
    return RunResult(summary, review)


def _grid_layer(page: PageServer, writer: RunWriter, resumed: StoredSession | None) -> GridLayer:
    """Return the occupancy grid of a run on its page."""
    from ..visualisation.live_page import GridLayer

    return GridLayer(page.state, lambda: np.array(writer.mounts())[:, :2], resumed)


def _let_page_save(page: PageServer, autosave: Autosave) -> None:
    """Save the map on request of the page, and report it there."""
    page.actions.save = autosave.request
    page.state.update(can_save=True)
    autosave.report = lambda text: page.state.update(message=text)


def review_log(
    directory: Path,
    config: Config,
    name: str,
    server: ViewerServer | None = None,
    seed: int | None = None,
    *,
    complete: bool,
) -> ReviewLog:
    """Create the review log in an output directory; `name` is that of the recording, for `complete` see `ReviewLog`."""
    from ..visualisation.rerun_log import ReviewLog

    settings = config_to_toml(config)
    return ReviewLog(
        directory / REVIEW,
        config=settings,
        recording=name,
        versions=versions(),
        server=server,
        seed=seed,
        complete=complete,
    )


def _shifted(messages: Iterable[Message], after: float, statistics: InputStatistics) -> Iterator[Message]:
    """Yield the messages; shift all stamps to later than `after` (seconds) if the first one is earlier than that."""
    for message in messages:
        if statistics.first == np.inf:
            statistics.shift = shift_after(message.stamp, after)
        yield replace(message, stamp=message.stamp + statistics.shift) if statistics.shift else message


def shift_after(first: float, after: float) -> float:
    """Return the seconds by which stamps are shifted if the first one is earlier than `after`, else zero."""
    return float(np.ceil(after - first)) + 1.0 if first < after else 0.0


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

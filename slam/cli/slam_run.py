"""One run of SLAM: from the messages of an input to a complete output directory."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.messages import Message
from drivers.timing.watched_view import watched

from ..config import Config, config_to_toml
from ..errors import MapError, MessageError
from ..events import Finished, Sink
from ..io.host import versions
from ..io.output_dir import REVIEW, OutputDirectory
from ..memory import LARGE_LIVE_BLOCK, return_code_of_imports, return_large_blocks
from ..reporting.input_statistics import InputStatistics
from ..reporting.notice_collector import NoticeCollector
from ..run_setup import RunSetup
from .autosave import Autosave
from .compilation import compile_all, compile_for_recording
from .console import print_if_slow
from .left_behind import print_left_behind
from .run_controls import RunControls
from .run_input import RunInput
from .run_summary import RunResult
from .run_writer import RunWriter

if TYPE_CHECKING:
    from ..io.sessions import StoredSession
    from ..pipeline import Slam
    from ..visualisation.live_page import GridLayer, PageServer
    from ..visualisation.rerun_log import ReviewLog, ViewerServer
    from .mode_switch import ModeSwitch

FINDING_TIMING = "estimating the timing of the lidar"
RUN_COLLECTION_THRESHOLD = 50_000
"""New objects of a run after which Python looks for garbage: to examine more at once would delay a scan."""


def run_slam(
    run_input: RunInput,
    setup: RunSetup,
    out: Path,
    *,
    overwrite: bool,
    review: bool,
    picture: bool,
    refine: bool = False,
    seed: int | None = None,
    controls: RunControls | None = None,
) -> RunResult:
    """Run SLAM on `run_input` and write the output directory `out`, which appears only when it is complete.

    setup      settings, and the session or the plan to begin with
    overwrite  replace an existing output directory
    review     write the review log
    picture    draw the map
    seed       of the simulation, for the summary
    controls   how people follow and steer the run

    Raises SlamError. On any exception nothing is left behind, but the last save of a live run stays after an error.
    """
    controls = controls or RunControls()
    page, keys, modes = controls.page, controls.keys, controls.modes
    print_left_behind(out)
    output = OutputDirectory(out, overwrite, reserved=not run_input.finite)
    with output as directory, ExitStack() as log, ExitStack() as saving:
        _load_code(finite=run_input.finite)
        notices, statistics, reviewed = NoticeCollector(), InputStatistics(keeps_odometry=picture), None
        sinks: list[Sink] = [notices, *run_input.sinks]
        if review:
            written = review_log(
                directory, setup.config, run_input.name, controls.server, seed, complete=run_input.finite
            )
            sinks.append(reviewed := log.enter_context(written))
        _settle_memory()
        writer = RunWriter(run_input, setup, statistics, notices.texts, picture, seed, time.perf_counter())
        autosave = Autosave(output, lambda: writer.snapshot(slam), keys)

        def idle() -> None:
            modes.poll()
            autosave.poll()

        if page is not None:
            sinks += [page.state, log.enter_context(_grid_layer(page, lambda: slam.lidar_mounts, setup.resumed))]
            _let_page_act(page, autosave, modes)
        modes.switched = partial(_show_mode, output, page)
        with run_input.opened(idle) as messages:
            slam = _start(run_input, setup, sinks, refine=refine)
            if not run_input.finite:
                saving.enter_context(autosave)
                saving.enter_context(modes.begin(slam, keys))
                saving.enter_context(keys)
                lidar = setup.config.lidar
                messages = watched(messages, run_input.report, (lidar.range_min, lidar.range_max))
            after = -np.inf if setup.resumed is None else setup.resumed.latest
            finished, busy = process_messages(statistics.read(messages, after), slam, run_input.name)
            saving.close()
            log.close()
            summary, write = writer.final(slam, finished, busy, None if reviewed is None else reviewed.left_out())
            output.finish(write)
    from ..visualisation.report_page import write_report_page

    write_report_page(out)
    return RunResult(summary, review)


def _load_code(*, finite: bool) -> None:
    """Compile and import what a run calls, so that no scan is delayed by it: everything, unless the input is finite."""
    if finite:
        compile_for_recording()
    else:
        compile_all()
        return_large_blocks(LARGE_LIVE_BLOCK)
    import_module("slam.pipeline")
    return_code_of_imports()  # before Rerun is imported, which needs as much


def _settle_memory() -> None:
    """Return what only the imports of a run needed, also those of its review log, and keep what they left."""
    return_code_of_imports()
    gc.freeze()  # otherwise a full collection over all imported modules delays a scan by 0.1 s
    gc.set_threshold(RUN_COLLECTION_THRESHOLD)


def _start(run_input: RunInput, setup: RunSetup, sinks: Sequence[Sink], *, refine: bool) -> Slam:
    """Return the pipeline of a run, after the settings that depend on the recording are resolved."""
    from ..pipeline import Slam

    with print_if_slow(FINDING_TIMING):
        config = run_input.resolve(setup.config)
    return Slam(
        config,
        sinks,
        refine=refine,
        keep_all_features=run_input.finite,
        resumed=setup.resumed,
        frozen=setup.frozen,
        start=setup.pose,
        plan=setup.plan,
    )


def _grid_layer(page: PageServer, mounts: Callable[[], Sequence[se2.Pose]], resumed: StoredSession | None) -> GridLayer:
    """Return the occupancy grid of a run on its page; `mounts` returns those of the lidars."""
    from ..visualisation.live_page import GridLayer

    return GridLayer(page.state, lambda: np.array(mounts() or [np.zeros(3)])[:, :2], resumed)


def _let_page_act(page: PageServer, autosave: Autosave, modes: ModeSwitch) -> None:
    """Save the map and change the mode on request of the page, and report there what was saved."""
    page.actions.save, page.actions.freeze = autosave.request, modes.request
    page.state.update(can_save=True, can_freeze=True)
    autosave.report = lambda text: page.state.update(message=text)


def _show_mode(output: OutputDirectory, page: PageServer | None, frozen: bool, problem: str) -> None:
    """Announce the mode of the run to other processes and the page, and why it was not changed, if so."""
    output.announce(lambda before: replace(before, frozen=frozen, switches=before.switches + 1, switch_problem=problem))
    if page is not None:
        page.state.update(frozen=frozen, **({"message": problem} if problem else {}))


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


def process_messages(messages: Iterable[Message], slam: Slam, name: str) -> tuple[Finished, float]:
    """Process all messages; return the result and the seconds that the pipeline took.

    Raises MapError with `name`, that of the recording.
    """
    busy = 0.0
    try:
        for message in messages:
            before = time.perf_counter()
            slam.add(message)
            busy += time.perf_counter() - before
        before = time.perf_counter()
        finished = slam.finish()
        return finished, busy + time.perf_counter() - before
    except (MapError, MessageError) as error:
        raise MapError(f"{name}: {error}") from error

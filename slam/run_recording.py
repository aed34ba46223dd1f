"""Map a recording with one call, as `wclm run` does, without writing files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers import se2
from drivers.arguments import check_items, path_of
from drivers.messages import Source

from .config import Config, load_config
from .errors import MapError, MessageError
from .evaluation.metrics import ReferenceScore, score_true_path
from .events import Finished, Sink
from .geometry.segments import Floats
from .io.output_dir import refuse_results
from .io.plans.units import Unit
from .io.recording_facts import RecordingFacts
from .io.recording_timing import timed
from .io.recordings import open_to_map, reason_without_odometry, recording_to_reopen
from .io.tum import Trajectory
from .mapped_recording import MappedRecording
from .offline.map_diff.plan_report import report_on_plan
from .pipeline import Slam
from .preprocessing.extraction import warn_of_compilation
from .reporting.input_statistics import InputStatistics
from .reporting.notice_collector import NoticeCollector
from .run_setup import PlanDrawing, RunSetup, prepare_run
from .run_start import check_arguments, initial_pose


def run(
    recording: Path | str,
    config: Config | None = None,
    *,
    refine: bool = False,
    sinks: Sequence[Sink] = (),
    continue_: Path | str | None = None,
    localize: Path | str | None = None,
    plan: Path | str | None = None,
    plan_unit: str | None = None,
    plan_layer: Sequence[str] = (),
    start: Sequence[float] | Floats | None = None,
) -> MappedRecording:
    """Map a recording, a bag or a simulation, as `wclm run` does with the options of the same names; write no files.

    recording   path, or a specification like `sim:office?seed=3`: see `drivers.open`
    config      settings, also of the topics of the lidars; a delay of the lidar that the recording shows is compensated
                if none is set, and a recording without odometry, or with one that is of no use, is mapped without it.
                By default those of the session that is continued or localised on, if there is one
    refine      refine the whole map offline: more accurate, and slower
    sinks       receive the events of the pipeline
    continue_   output directory of an earlier run, whose map is extended from wherever the robot is in it
    localize    map to localise on without changing it: output directory of an earlier run, or a plan
    plan        plan of the building whose walls help mapping; the map is in its frame
    plan_unit   unit of length of a drawing: m, cm, mm, ft or in; by default as it states, else metres
    plan_layer  layers of a DXF drawing with walls; all if there is none
    start       with one of the three: roughly where the robot starts in the map, [x, y, heading] (metres, radians)

    Raises SlamError, with one line that names the place, if the recording cannot be read or mapped.
    """
    if refine and localize is not None:
        raise MapError("a run that only localises does not extend the map, so there is nothing to refine")
    check_arguments(config, sinks, None, None)
    check_items("plan_layer", plan_layer, str, "names")
    setup = prepare_run(
        lambda stored: config or load_config(stored),
        None if continue_ is None else path_of("continue_", continue_),
        None if localize is None else path_of("localize", localize),
        None if plan is None else path_of("plan", plan),
        None if start is None else initial_pose(start),
        PlanDrawing(None if plan_unit is None else _unit(plan_unit), plan_layer),
    )
    return _map(str(recording), setup, sinks, refine=refine)


def _map(recording: str, setup: RunSetup, sinks: Sequence[Sink], *, refine: bool) -> MappedRecording:
    """Map a recording from the initial state of the run on, see `run`."""
    warn_of_compilation()
    source, reason = open_to_map(refuse_results(recording), setup.config)
    config = setup.config if reason is None else setup.config.without_odometry()
    used, timing, second = timed(source, config, None if setup.resumed is None else setup.resumed.last_mount)
    notices = NoticeCollector()
    slam = _start(used, setup, [notices, *sinks], refine=refine)
    facts, statistics = RecordingFacts(timing, second), InputStatistics(keeps_odometry=True)
    after = -np.inf if setup.resumed is None else setup.resumed.latest
    try:
        for message in statistics.read(facts.read(source), after):
            slam.add(message)
        finished = slam.finish()
    except (MapError, MessageError) as error:
        raise MapError(f"{source.name}: {error}") from error
    on_plan = None if setup.plan is None else report_on_plan(setup.plan, slam)
    figures = facts.figures(source.report)
    figures["interpretations"] += [*setup.notes, *_notes_on_odometry(setup, source, reason)]
    figures["warnings"] = notices.texts
    score, true_path = _true_path(finished, statistics.truth, used, 0.0 if slam.extends_map else statistics.shift)
    if score is not None:
        figures["truth"] = score.figures()
    return MappedRecording(
        name=source.name,
        finished=finished,
        odometry=odometry_path(finished, statistics.first, statistics.odometry_poses.rows),
        truth=true_path,
        slam=slam,
        source=source,
        reopen=recording_to_reopen(recording),
        config=config,
        facts=figures if on_plan is None else figures | {"plan": on_plan.summary},
        shift=statistics.shift,
        on_plan=on_plan,
    )


def _start(config: Config, setup: RunSetup, sinks: Sequence[Sink], *, refine: bool) -> Slam:
    """Return the pipeline of a run with the settings `config`, to which those from the recording were added."""
    return Slam(
        config,
        sinks,
        refine=refine,
        keep_all_features=True,
        resumed=setup.resumed,
        frozen=setup.frozen,
        start=setup.pose,
        plan=setup.plan,
    )


def _notes_on_odometry(setup: RunSetup, source: Source, reason: str | None) -> list[str]:
    """Return why odometry is not used, if so; `reason` is that of the recording."""
    if reason is not None:
        return [f"{reason}; mapped by the scans alone"]
    if setup.leaves_out_odometry and reason_without_odometry(source) is None:
        return ["odometry is not used, as the session was mapped without"]
    return []


def _unit(name: str) -> Unit:
    """Return a unit of length by its name. Raises MapError if there is none."""
    try:
        return Unit(name)
    except ValueError as error:
        raise MapError(f"plan_unit: {name!r}: must be one of {', '.join(Unit)}") from error


def odometry_path(finished: Finished, first: float, poses: Floats) -> Floats:
    """Return the odometry `poses` (m, 3) of a run that began at the stamp `first`, in the map: from the same start."""
    if not len(poses):
        return poses
    start = min(int(np.searchsorted(finished.stamps, first)), len(finished.poses) - 1)
    return se2.compose(finished.poses[start], se2.between(poses[0], poses))


def _true_path(
    finished: Finished, truth: Trajectory | None, config: Config, shift: float
) -> tuple[ReferenceScore, Trajectory] | tuple[None, None]:
    """Return the error of the path and the true path in the map; None if there is none at the time of the path.

    shift  seconds that are subtracted from its stamps
    """
    if truth is None:
        return None, None
    score, path = score_true_path(Trajectory(finished.stamps, finished.poses), truth, config.lidar.delay)
    if score is None or path is None:
        return None, None
    return score, Trajectory(path.stamps - shift, path.poses)

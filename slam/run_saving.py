"""Saving of a run as the output directory that all commands read, from a program in Python."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from drivers.arguments import check_type, path_of

from .events import Finished
from .io.output_dir import REPORT, OutputDirectory
from .io.run_results import read_run_results, write_results
from .io.tum import Trajectory
from .pipeline import Slam
from .reporting.summary import summarise

if TYPE_CHECKING:
    from .config import Config
    from .io.sessions import Recording
    from .offline.map_diff.plan_report import PlanReport


def save_run(
    pipeline: Slam,
    finished: Finished,
    directory: Path | str,
    *,
    name: str = "run",
    recording: Recording | None = None,
    config: Config | None = None,
    facts: Mapping[str, Any] | None = None,
    on_plan: PlanReport | None = None,
    overwrite: bool = False,
) -> None:
    """Write the output directory of a run that has ended, as `wclm run` does, without the review log.

    pipeline   that has made the run
    finished   what its `finish` returned
    directory  appears when it is complete
    name       of the run in the results. Sessions of one name with the same first and last stamps are not merged: they
               count as made from one recording
    recording  that was mapped, to be found again; by default the measurements cannot be read again, and no occupancy
               grid drawn from them
    config     settings that are written, without what the recording shows of the lidars; by default those of the run
    facts      additional entries of summary.json
    on_plan    comparison with the plan that the map was made with, whose differences are written, too
    overwrite  replace earlier results

    `slam.io.run_results.read_run_results` reads the results, `slam.io.sessions.read_session` what `Slam(resumed=...)`
    continues. A run that has only localised in a map has no session. Raises OutputError if the directory exists or
    cannot be written.
    """
    from .io.sessions import Recording, write_session
    from .io.sessions.records import to_pose
    from .visualisation.report_page import write_page

    check_type("pipeline", pipeline, Slam, "a Slam")
    check_type("finished", finished, Finished, "what finish() has returned")
    check_type("name", name, str, "a text")
    place = path_of("directory", directory)
    earlier = pipeline.session.recordings
    own = finished.stamps > max((one.last for one in earlier), default=-math.inf)
    driven = Trajectory(finished.stamps[own], finished.poses[own])
    first, last = float(driven.stamps[0]), float(driven.stamps[-1])
    readings = sum(np.count_nonzero(history.stamps >= first) for history in pipeline.session.odometry)
    lidars = [to_pose(mount) for mount in pipeline.lidar_mounts]
    recording = recording or Recording(name=name, path=None, first=first, last=last, lidars=lidars)
    session = replace(pipeline.session, recordings=[*earlier, recording])
    saved = session.recordings if pipeline.extends_map else [recording]
    summary = summarise(
        finished,
        recording=name,
        recording_path=recording.path,
        scans=cast(int, finished.summary["scans"]),
        odometry=int(readings),
        duration=driven.duration,
        path_length=driven.length,
    ) | {
        "lidars": lidars,
        "recordings": [one.model_dump() for one in saved],
        **(facts or {}),
    }
    with OutputDirectory(place, overwrite) as folder:
        if pipeline.extends_map:
            write_session(folder, session)
        write_results(folder, finished, config or pipeline.config, summary)
        if on_plan is not None:
            on_plan.write(folder)
        write_page(folder / REPORT, read_run_results(folder))

"""Writing a run into a directory: its final results, or its state while it goes on."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers import se2

from ..errors import first_line
from ..evaluation.metrics import ReferenceScore, score_true_path
from ..events import Finished
from ..geometry.segments import Floats
from ..io.drives import split_drives
from ..io.output_dir import PICTURE, SESSION
from ..io.run_results import write_results
from ..io.tum import Trajectory
from ..memory import return_code_of_imports, return_freed_memory
from ..reporting.input_statistics import InputStatistics
from ..reporting.summary import RunTimes
from ..run_setup import RunSetup
from .run_input import RunInput, recording_entry
from .run_summary import summarise_run

if TYPE_CHECKING:
    from ..config import Config
    from ..io.sessions import StoredSession
    from ..pipeline import Slam

Write = Callable[[Path], None]
"""Function that writes results into a directory; it raises OSError."""
NO_SESSION = "the session is not written, so the map cannot be continued, refined or corrected"
NO_PLAN_DIFFERENCES = "the differences from the plan are not written"
NO_PICTURE = "the picture of the map is not written"


@dataclass(slots=True, eq=False)
class RunWriter:
    """Writer of the run of `run_input`.

    setup    what the run begins with
    notices  texts, which are still added
    picture  draw the final map
    seed     of the simulation, for the summary
    started  time of the first message, on the clock of time.perf_counter
    """

    run_input: RunInput
    setup: RunSetup
    statistics: InputStatistics
    notices: list[str]
    picture: bool
    seed: int | None
    started: float

    def snapshot(self, slam: Slam) -> Write:
        """Return a function that writes the state of this moment. Raises MapError if there is no map yet."""
        copy, extended, mounts, config = slam.snapshot(), slam.extends_map, slam.lidar_mounts, slam.config
        took = time.perf_counter() - self.started

        def write(place: Path) -> None:
            finished = copy.finished()
            times = RunTimes(took, took)
            summary = self._summarise(finished, copy.session, config, None, times, extended, mounts)
            summary["unfinished"] = True
            self._write(place, finished, summary, _parts(copy.session if extended else None))

        return write

    def final(
        self, slam: Slam, finished: Finished, slam_seconds: float, left_out: dict[str, int] | None
    ) -> tuple[dict[str, Any], Write]:
        """Return the summary of the ended run and a function that writes its results.

        left_out  what the review log does not contain; None without one
        """
        return_freed_memory()  # to write tables, libraries are loaded that need as much
        return_code_of_imports()
        score = score_against_truth(finished, self.statistics, slam.config)
        took = time.perf_counter() - self.started
        times = RunTimes(slam_seconds, took)
        extended, mounts = slam.extends_map, slam.lidar_mounts
        summary = self._summarise(finished, slam.session, slam.config, score, times, extended, mounts)
        summary["review"] = left_out
        on_plan = None
        if self.setup.plan is not None:
            from ..offline.map_diff.plan_report import report_on_plan

            on_plan = report_on_plan(self.setup.plan, slam)
        if on_plan is not None:
            summary["plan"] = on_plan.summary

        parts = _parts(slam.session if slam.extends_map else None)
        if on_plan is not None:
            parts[NO_PLAN_DIFFERENCES] = on_plan.write
        if self.picture:
            parts[NO_PICTURE] = lambda place: _draw(
                place / PICTURE, finished, self.statistics, score, self.run_input.name, summary["recordings"]
            )
        return summary, lambda place: self._write(place, finished, summary, parts)

    def _summarise(
        self,
        finished: Finished,
        session: StoredSession,
        config: Config,
        score: ReferenceScore | None,
        times: RunTimes,
        extended: bool,
        mounts: Sequence[se2.Pose],
    ) -> dict[str, Any]:
        """Return the summary; add the recording of this run to the session.

        config            settings as used, with what the recording shows of the lidars
        extended, mounts  `Slam.extends_map` and `Slam.lidar_mounts`
        """
        summary = summarise_run(
            self.run_input,
            finished,
            self.statistics,
            self.notices,
            score,
            seed=self.seed,
            times=times,
        )
        session.recordings.append(recording_entry(self.run_input, self.statistics, config, mounts))
        recordings = session.recordings if extended else session.recordings[-1:]
        return summary | {
            "lidars": [mount.tolist() for mount in mounts],
            "recordings": [recording.model_dump() for recording in recordings],
        }

    def _write(self, place: Path, finished: Finished, summary: dict[str, Any], parts: Mapping[str, Write]) -> None:
        """Write first the dispensable `parts`, given by the warning if they fail, and then the results.

        A failed part must not cost trajectory and map, whatever the reason: its warning is added to `summary`. Only an
        OSError is raised, as on a full disk: everything can be written in another place then.
        """
        for warning, write in parts.items():
            try:
                write(place)
            except OSError:
                raise
            except Exception as error:
                summary["warnings"] = [*summary["warnings"], f"{warning}: {type(error).__name__}: {first_line(error)}"]
        write_results(place, finished, self.setup.config, summary)


def _parts(session: StoredSession | None) -> dict[str, Write]:
    """Return the function that writes a session, if there is one, under the warning that it has failed."""
    return {} if session is None else {NO_SESSION: partial(_write_session, session)}


def _write_session(session: StoredSession, place: Path) -> None:
    """Write a session, or nothing of it."""
    from ..io.sessions import write_session

    try:
        write_session(place, session)
    except BaseException:
        shutil.rmtree(place / SESSION, ignore_errors=True)
        raise


def score_against_truth(finished: Finished, statistics: InputStatistics, config: Config) -> ReferenceScore | None:
    """Score the path against the ground truth; return None if there is none for the time of the path."""
    if statistics.truth is None:
        return None
    return score_true_path(Trajectory(finished.stamps, finished.poses), statistics.truth, config.lidar.delay)[0]


def _draw(
    path: Path,
    finished: Finished,
    statistics: InputStatistics,
    score: ReferenceScore | None,
    title: str,
    recordings: Sequence[Mapping[str, Any]],
) -> None:
    from ..run_recording import odometry_path
    from ..visualisation.plots import plot_map

    odometry: Floats | None = None
    if statistics.odometry:
        odometry = odometry_path(finished, statistics.first, statistics.odometry_poses.rows)
    truth = None if score is None else se2.compose(se2.inverse(score.alignment), score.reference)
    drives = split_drives(Trajectory(finished.stamps, finished.poses), recordings)
    plot_map(path, finished.walls, finished.corners, drives, title=title, odometry=odometry, truth=truth)

"""One recording through the whole system into one output directory: what `run` and `demo` have in common."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan, Source

from ..config import Config, config_to_toml
from ..errors import MapError
from ..evaluation import ReferenceScore, score_reference
from ..events import Event, Finished, Noticed
from ..outputs import PICTURE, REPORT, REVIEW, OutputDirectory, unfinished_file, write_results
from ..trajectory import Trajectory
from .console import progress, say_if_slow
from .report import summarise, versions

if TYPE_CHECKING:
    from ..plots.style import Floats


COMPILING = "compiling, once after an installation or a change; this takes about half a minute"


@dataclass(slots=True)
class Tally:
    """What went in: counts, the span of time, and the paths that odometry and truth tell of."""

    scans: int = 0
    first: float = np.inf
    last: float = -np.inf
    odometry: list[se2.Pose] = field(default_factory=list)
    truth_stamps: list[float] = field(default_factory=list)
    truth: list[se2.Pose] = field(default_factory=list)

    def add(self, message: Message) -> None:
        """Take note of a message."""
        if isinstance(message, GroundTruth):
            self.truth_stamps.append(message.stamp)
            self.truth.append(message.pose)
            return
        self.first, self.last = min(self.first, message.stamp), max(self.last, message.stamp)
        if isinstance(message, Odometry):
            self.odometry.append(message.pose)
        elif isinstance(message, Scan):
            self.scans += 1

    @property
    def duration(self) -> float:
        """Seconds from the first measurement to the last."""
        return max(0.0, self.last - self.first)


@dataclass(slots=True)
class Notices:
    """A sink that keeps what a person should know."""

    texts: list[str] = field(default_factory=list)

    def handle(self, event: Event) -> None:
        """Take one event."""
        if isinstance(event, Noticed):
            self.texts.append(f"{event.text} (at {event.stamp:.2f} s)")


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What a session left behind: the summary as it stands in summary.json, and whether there is a review log."""

    summary: dict[str, Any]
    review: bool


def lasting(recording: str) -> str:
    """What opens the same recording from another directory, too."""
    return recording if recording.startswith("sim:") else str(Path(recording).resolve())


def map_source(
    source: Source,
    config: Config,
    out: Path,
    *,
    overwrite: bool,
    review: bool,
    picture: bool,
    refine: bool = False,
    seed: int | None = None,
    reopen: str | None = None,
) -> Outcome:
    """Run SLAM over `source` and write `out`, which appears only when everything in it is complete.

    `reopen` is what `drivers.open` takes for the same messages again, if anything does.
    Raises SlamError; whatever is raised, nothing is left behind.
    """
    with OutputDirectory(out, overwrite) as directory, ExitStack() as cleanup:
        from ..pipeline import Slam
        from ..warmup import warm_up

        with say_if_slow(COMPILING):
            warm_up()
        notices, tally = Notices(), Tally()
        sinks: list[Any] = [notices]
        if review:
            from ..review import ReviewLog

            log = ReviewLog(
                directory / REVIEW, config=config_to_toml(config), recording=source.name, versions=versions()
            )
            sinks.append(log)
            cleanup.callback(log.close)
        started = time.perf_counter()
        slam = Slam(config, sinks, refine=refine)
        busy = 0.0
        try:
            for message in progress(source, len(source), source.name):
                tally.add(message)
                before = time.perf_counter()
                slam.add(message)
                busy += time.perf_counter() - before
            before = time.perf_counter()
            finished = slam.finish()
            busy += time.perf_counter() - before
        except MapError as error:  # the pipeline knows no recording
            raise MapError(f"{source.name}: {error}") from error
        cleanup.close()
        score = score_against_truth(finished, tally)
        if picture:
            _draw(directory / PICTURE, finished, tally, score, source.name)
        took = time.perf_counter() - started
        summary = summarise(
            source, finished, tally, notices.texts, score, seed=seed, reopen=reopen, slam_seconds=busy, seconds=took
        )
        write_results(directory, finished, config, summary)
    _write_page(out)
    return Outcome(summary, review)


def _write_page(out: Path) -> None:
    """The page follows when the results are in place: should it fail, they are not lost."""
    from ..exports import read_session
    from ..page import write_page

    with unfinished_file(out / REPORT) as unfinished:
        write_page(unfinished, read_session(out))


def score_against_truth(finished: Finished, tally: Tally) -> ReferenceScore | None:
    """How far the path is from the true one, if the recording knows it."""
    if not tally.truth:
        return None
    truth = Trajectory(np.array(tally.truth_stamps), np.array(tally.truth))
    try:
        return score_reference(Trajectory(finished.stamps, finished.poses), truth)
    except MapError:  # the truth is of another time
        return None


def _draw(path: Path, finished: Finished, tally: Tally, score: ReferenceScore | None, title: str) -> None:
    from ..plots import plot_map

    odometry: Floats | None = None
    if tally.odometry:
        told = np.array(tally.odometry)
        odometry = se2.compose(finished.poses[0], se2.between(told[0], told))
    truth = None if score is None else se2.compose(se2.inverse(score.alignment), score.reference)
    plot_map(path, finished.lines, finished.corners, finished.poses, title=title, odometry=odometry, truth=truth)

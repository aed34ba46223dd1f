"""Messages through the whole system into one output directory: what `run`, `demo` and `live` have in common."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan, Source, SourceReport

from ..config import Config, config_to_toml
from ..errors import MapError
from ..evaluation import ReferenceScore, score_reference
from ..events import Event, Finished, Noticed, Sink
from ..machine import versions
from ..outputs import PICTURE, REPORT, REVIEW, OutputDirectory, unfinished_file, write_results
from ..trajectory import Trajectory
from .console import progress, say_if_slow
from .report import summarise

if TYPE_CHECKING:
    from ..pipeline import Slam
    from ..plots.style import Floats
    from ..review import ReviewLog, ViewerServer


COMPILING = "compiling, once after an installation or a change; this takes about half a minute"


class Feed(Protocol):
    """Where a session's messages come from, and who looks on.

    name   of the source
    sinks  take the pipeline's events
    """

    name: str
    sinks: Sequence[Sink]

    @property
    def report(self) -> SourceReport:
        """What was left out; complete after the last message."""
        ...

    @property
    def reopen(self) -> str | None:
        """What `drivers.open` takes for the same messages again, if anything does; known after the last message."""
        ...

    def opened(self) -> AbstractContextManager[Iterable[Message]]:
        """The messages, within a context that lasts until the map is finished."""
        ...

    def facts(self) -> dict[str, Any]:
        """What else the summary should tell, after the last message."""
        ...


class Playback:
    """A `Feed` out of a recording or a simulation, with a progress bar."""

    def __init__(self, source: Source, reopen: str) -> None:
        self.name, self.reopen = source.name, reopen
        self.sinks: Sequence[Sink] = ()
        self._source = source

    @property
    def report(self) -> SourceReport:
        """The source's."""
        return self._source.report

    @contextmanager
    def opened(self) -> Iterator[Iterable[Message]]:
        """All messages."""
        yield progress(self._source, len(self._source), self.name)

    def facts(self) -> dict[str, Any]:
        """Nothing that the source's report does not say."""
        return {}


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


def map_feed(
    feed: Feed,
    config: Config,
    out: Path,
    *,
    overwrite: bool,
    review: bool,
    picture: bool,
    refine: bool = False,
    seed: int | None = None,
    server: ViewerServer | None = None,
) -> Outcome:
    """Run SLAM over `feed` and write `out`, which appears only when everything in it is complete.

    Viewers can look on at `server` if there is a review log. Raises SlamError; whatever is raised, nothing is left
    behind.
    """
    with OutputDirectory(out, overwrite) as directory, ExitStack() as log:
        from ..pipeline import Slam
        from ..warmup import warm_up

        with say_if_slow(COMPILING):
            warm_up()
        notices, tally = Notices(), Tally()
        sinks: list[Sink] = [notices, *feed.sinks]
        if review:
            sinks.append(log.enter_context(_review_log(directory, config, feed, server)))
        started = time.perf_counter()
        with feed.opened() as messages:
            finished, busy = _follow(messages, Slam(config, sinks, refine=refine), tally, feed.name)
            log.close()
            score = score_against_truth(finished, tally)
            if picture:
                _draw(directory / PICTURE, finished, tally, score, feed.name)
            took = time.perf_counter() - started
            summary = summarise(feed, finished, tally, notices.texts, score, seed=seed, slam_seconds=busy, seconds=took)
            write_results(directory, finished, config, summary)
    _write_page(out)
    return Outcome(summary, review)


def _review_log(directory: Path, config: Config, feed: Feed, server: ViewerServer | None) -> ReviewLog:
    from ..review import ReviewLog

    settings = config_to_toml(config)
    return ReviewLog(directory / REVIEW, config=settings, recording=feed.name, versions=versions(), server=server)


def _follow(messages: Iterable[Message], slam: Slam, tally: Tally, name: str) -> tuple[Finished, float]:
    """Give the pipeline all messages; what came of it, and the seconds it took. Raises MapError."""
    busy = 0.0
    try:
        for message in messages:
            tally.add(message)
            before = time.perf_counter()
            slam.add(message)
            busy += time.perf_counter() - before
        before = time.perf_counter()
        finished = slam.finish()
        return finished, busy + time.perf_counter() - before
    except MapError as error:  # the pipeline knows no recording
        raise MapError(f"{name}: {error}") from error


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

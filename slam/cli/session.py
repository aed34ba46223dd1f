"""Messages through the whole system into one output directory: what `run`, `demo` and `live` have in common."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import typer

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan, Source, SourceReport

from ..config import Config, config_to_toml, load_config
from ..errors import MapError
from ..evaluation.metrics import ReferenceScore, score_reference
from ..events import Event, Finished, Notice, Sink
from ..io.host import versions
from ..io.output_dir import CONFIG, PICTURE, REPORT, REVIEW, OutputDirectory, unfinished_file, write_results
from ..io.tum import Trajectory
from .console import progress, say_if_slow
from .report import summarise

if TYPE_CHECKING:
    from ..io.sessions import Recording, StoredSession
    from ..pipeline import Slam
    from ..visualisation.plots.style import Floats
    from ..visualisation.rerun_log import ReviewLog, ViewerServer


READING = "reading the session"
COMPILING = "compiling, once after an installation or a change; this takes about half a minute"


class Feed(Protocol):
    """Where a session's messages come from, and who looks on.

    name    of the source
    sinks   take the pipeline's events
    finite  whether it ends by itself; of what may last for days, memory must not grow with time
    """

    name: str
    finite: bool
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
        self.name, self.reopen, self.finite = source.name, reopen, True
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


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """What a run starts from: the settings, and the session to go on from, on whose map, if `frozen`, only the path is
    looked for."""

    config: Config
    resumed: StoredSession | None
    frozen: bool


def begin(continued: Path | None, localized: Path | None, config: Path | None, settings: Sequence[str] | None) -> Start:
    """What the options say a run starts from. A session's settings hold, but for those that are named.

    Raises SlamError where they cannot be had, or the session has no map.
    """
    if continued is not None and localized is not None:
        raise typer.BadParameter("either the map grows or it stays as it is", param_hint="--continue / --localize")
    session = continued or localized
    if session is None:
        return Start(load_config(config, settings or ()), None, False)
    from ..io.sessions import read_stored

    with say_if_slow(READING):
        resumed = read_stored(session)
    if not resumed.slam_state.mapper.keyframe_count:
        raise MapError(f"{session}: has no keyframe, so there is nothing to go on from")
    return Start(load_config(config or session / CONFIG, settings or ()), resumed, localized is not None)


@dataclass(slots=True)
class Tally:
    """What went in: counts, the span of time, and the paths that odometry and truth tell of; `shift` seconds were added
    to all stamps."""

    scans: int = 0
    shift: float = 0.0
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

    def recording(self, feed: Feed) -> Recording:
        """What a session says of the recording that went in."""
        from ..io.sessions import Recording

        first, last = (self.first, self.last) if np.isfinite(self.first) else (0.0, 0.0)
        return Recording(name=feed.name, path=feed.reopen, shift=self.shift, first=first, last=last)

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
        if isinstance(event, Notice):
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
    resumed: StoredSession | None = None,
    frozen: bool = False,
    server: ViewerServer | None = None,
) -> Outcome:
    """Run SLAM over `feed` and write `out`, which appears only when everything in it is complete.

    `resumed` is a session to go on from, on whose map, if `frozen`, only the path is looked for. Viewers can look on at
    `server` if there is a review log. Raises SlamError; whatever is raised, nothing is left behind.
    """
    with OutputDirectory(out, overwrite) as directory, ExitStack() as log:
        from ..io.sessions import write_stored
        from ..pipeline import Slam
        from ..warmup import warm_up

        with say_if_slow(COMPILING):
            warm_up()
        gc.freeze()  # what was imported stays: to search it for garbage would hold up a scan by 0.1 s
        notices, tally = Notices(), Tally()
        sinks: list[Sink] = [notices, *feed.sinks]
        reviewed = None
        if review:
            reviewed = log.enter_context(review_log(directory, config, feed.name, server, seed))
            sinks.append(reviewed)
        started = time.perf_counter()
        with feed.opened() as messages:
            slam = Slam(config, sinks, refine=refine, keep_views=feed.finite, resumed=resumed, frozen=frozen)
            after = -np.inf if resumed is None else resumed.latest
            finished, busy = follow(_later(messages, after, tally), slam, tally, feed.name)
            log.close()
            score = score_against_truth(finished, tally)
            if picture:
                _draw(directory / PICTURE, finished, tally, score, feed.name)
            took = time.perf_counter() - started
            summary = summarise(feed, finished, tally, notices.texts, score, seed=seed, slam_seconds=busy, seconds=took)
            session = slam.session
            session.recordings.append(tally.recording(feed))
            recordings = session.recordings[-1:] if frozen else session.recordings
            summary["recordings"] = [recording.model_dump() for recording in recordings]
            summary["review"] = None if reviewed is None else reviewed.left_out()
            write_results(directory, finished, config, summary)
            if not frozen:
                write_stored(directory, session)
    write_page_of(out)
    return Outcome(summary, review)


def review_log(
    directory: Path, config: Config, name: str, server: ViewerServer | None = None, seed: int | None = None
) -> ReviewLog:
    """A review log in a directory of results; `name` is that of the recording."""
    from ..visualisation.rerun_log import ReviewLog

    settings = config_to_toml(config)
    return ReviewLog(directory / REVIEW, config=settings, recording=name, versions=versions(), server=server, seed=seed)


def _later(messages: Iterable[Message], after: float, tally: Tally) -> Iterator[Message]:
    """The messages, with stamps that go on `after` a time (seconds), if their clock has not gone on since."""
    for message in messages:
        if tally.first == np.inf and message.stamp < after:
            tally.shift = float(np.ceil(after - message.stamp)) + 1.0
        yield replace(message, stamp=message.stamp + tally.shift) if tally.shift else message


def follow(messages: Iterable[Message], slam: Slam, tally: Tally, name: str) -> tuple[Finished, float]:
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


def write_page_of(out: Path) -> None:
    """The page follows when the results are in place: should it fail, they are not lost."""
    from ..io.exports import read_session
    from ..visualisation.report_page import write_page

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
    from ..visualisation.plots import plot_map

    odometry: Floats | None = None
    if tally.odometry:
        told = np.array(tally.odometry)
        begun = min(int(np.searchsorted(finished.stamps, tally.first)), len(finished.poses) - 1)
        odometry = se2.compose(finished.poses[begun], se2.between(told[0], told))
    truth = None if score is None else se2.compose(se2.inverse(score.alignment), score.reference)
    plot_map(path, finished.lines, finished.corners, finished.poses, title=title, odometry=odometry, truth=truth)

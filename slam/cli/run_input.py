"""Input of a run: its messages, and where they can be read again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from drivers import se2
from drivers.messages import Message, Source, SourceReport

from ..config import Config
from ..events import Sink
from ..io.recording_facts import RecordingFacts
from ..io.recording_timing import timed
from ..reporting.input_statistics import InputStatistics
from .console import progress

if TYPE_CHECKING:
    from ..io.sessions import Recording, StoredSession


class RunInput(Protocol):
    """Input of a run: messages and additional sinks.

    name    of the source
    sinks   receive the events of the pipeline
    finite  if the input ends by itself; otherwise it may last for days, and memory must not grow with time
    """

    name: str
    finite: bool
    sinks: Sequence[Sink]

    @property
    def report(self) -> SourceReport:
        """Skipped messages; complete after the last message."""
        ...

    @property
    def reopen(self) -> str | None:
        """Argument of `drivers.open` that yields the same messages again, None if there is none; valid after the last
        message.
        """
        ...

    def opened(self, idle: Callable[[], None]) -> AbstractContextManager[Iterable[Message]]:
        """Return a context that provides the messages and must stay open until the map is finished.

        `idle` is called between messages if the input is not finite, several times per second.
        """
        ...

    def resolve(self, config: Config) -> Config:
        """Return the settings with those that the input determines itself, such as the lidar's delay."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return additional entries for the summary; valid after the last message."""
        ...


class RecordingInput:
    """A `RunInput` from a recording or a simulation, with a progress bar."""

    def __init__(self, source: Source, reopen: str, earlier: StoredSession | None = None) -> None:
        """`earlier` is the session that the run continues or localises in: its lidar is probably the same."""
        self.name, self.reopen, self.finite = source.name, reopen, True
        self._earlier_mount = None if earlier is None else earlier.last_mount
        self.sinks: Sequence[Sink] = ()
        self._source = source
        self._facts: RecordingFacts | None = None

    @property
    def report(self) -> SourceReport:
        """Report of the source."""
        return self._source.report

    @contextmanager
    def opened(self, idle: Callable[[], None]) -> Iterator[Iterable[Message]]:
        """Provide all messages; `idle` is not called."""
        yield progress(self._messages(), len(self._source), self.name)

    def _messages(self) -> Iterator[Message]:
        assert self._facts is not None
        yield from self._facts.read(self._source)

    def resolve(self, config: Config) -> Config:
        """Return the settings with each lidar's delay that the recording shows, if none is set."""
        config, timing, second = timed(self._source, config, self._earlier_mount)
        self._facts = RecordingFacts(timing, second)
        return config

    def facts(self) -> dict[str, Any]:
        """Return the gaps in the recording, the timing of the lidar, and how the recording was read."""
        assert self._facts is not None
        return self._facts.figures(self.report)


def recording_entry(
    run_input: RunInput, statistics: InputStatistics, config: Config, mounts: Sequence[se2.Pose]
) -> Recording:
    """Return the entry of the recording in a session; `config` and `mounts` of the lidars are those used."""
    from ..io.sessions import Recording
    from ..io.sessions.records import to_pose

    first, last = (statistics.first, statistics.last) if np.isfinite(statistics.first) else (0.0, 0.0)
    return Recording.model_construct(
        name=run_input.name,
        path=run_input.reopen,
        shift=statistics.shift,
        first=first,
        last=last,
        recorded_stamps=run_input.report.recorded_stamps,
        settings=config,
        lidars=[to_pose(mount) for mount in mounts],
    )

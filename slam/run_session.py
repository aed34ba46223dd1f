"""Sessions of a run: what it leaves to be stored and continued, at its end or at one moment while it goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .config import Config
from .estimation.journal import Journal
from .estimation.slam_state import SlamState
from .io.stored_session import StoredSession
from .preprocessing.preprocessor import Preprocessor
from .run_snapshot import RunSnapshot
from .run_statistics import RunStatistics


@dataclass(slots=True, eq=False)
class RunSession:
    """Parts of a run of which its session consists, besides the estimate.

    earlier  session that the run continues; None if there is none, or if its map is left out of the results
    """

    config: Config
    journal: Journal
    preprocessor: Preprocessor
    statistics: RunStatistics
    earlier: StoredSession | None

    def at_end(self, state: SlamState) -> StoredSession:
        """Return the session of a run without queued scans; `state` is then no longer changed by the run."""
        state.mapper.gauge.release(state.mapper)
        state.mapper.graph.solver.dismiss_isam()
        return self._stored(state)

    def with_queue(self, state: SlamState) -> StoredSession:
        """Return the session with the queued scans still in the queue, as if the run had not ended."""
        session = self.at_end(state)
        session.scans, session.queued_scans = self.journal.scans.copy(), self.preprocessor.queued
        return session

    def snapshot(self, state: SlamState, summary: dict[str, Any], after: float) -> RunSnapshot:
        """Return a copy of the run while it goes on; for `summary` and `after` see `RunSnapshot`."""
        segments = self.journal.segments
        session = self._stored(state.copy())
        session.scans, session.queued_scans = self.journal.scans.copy(), self.preprocessor.queued
        session.starts = list(segments.starts)
        session.odometry = [history.copy() for history in segments.histories]
        return RunSnapshot(session, summary, after)

    def _stored(self, state: SlamState) -> StoredSession:
        earlier, journal = self.earlier, self.journal
        return StoredSession(
            config=self.config,
            slam_state=state,
            scans=journal.scans,
            odometry=journal.segments.histories,
            starts=journal.segments.starts,
            noise=self.preprocessor.noise,
            second_noise=self.preprocessor.second_noise,
            recordings=[] if earlier is None else list(earlier.recordings),
            loop_decisions=[*(() if earlier is None else earlier.loop_decisions), *self.statistics.loops],
        )

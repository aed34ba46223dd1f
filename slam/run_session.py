"""What a run leaves to be stored and continued: its session, at the end or at one moment while the run goes on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.immutable import immutable

from .config import Config
from .errors import MapError
from .estimation.journal import Journal
from .estimation.map_view import covariances_when_last_seen, map_features
from .estimation.slam_state import SlamState
from .events import Finished
from .io.stored_session import StoredSession
from .loop_closure.agreement import LoopAgreement
from .mapping.map_features import Keyframes
from .memory import return_freed_memory
from .preprocessing.preprocessor import Preprocessor
from .reporting.run_statistics import RunStatistics


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
        state.local_field.free()
        return_freed_memory()
        return self._stored(state)

    def with_queue(self, state: SlamState) -> StoredSession:
        """Return the session with the queued scans still in the queue, as if the run had not ended."""
        session = self.at_end(state)
        session.scans, session.queued_scans = self.journal.scans.copy(), self.preprocessor.queued
        return session

    def add_last_decisions(self, session: StoredSession, loops: LoopAgreement) -> None:
        """Add the decisions that the end of the run has led to, with numbers by `loops`, to a session from before it.

        Those about keyframes of scans that are queued in the session are left out: they will be decided again.
        """
        decisions, keyframes = self._loop_decisions, session.slam_state.mapper.keyframe_count
        session.loop_decisions = [decision for decision in decisions if decision["keyframe"] < keyframes]
        session.slam_state.loops.number_after(loops.state.candidates)

    def snapshot(self, state: SlamState, summary: dict[str, Any], after: float) -> RunSnapshot:
        """Return a copy of the run while it goes on; for `summary` and `after` see `RunSnapshot`."""
        segments, copied = self.journal.segments, state.copy()
        if copied.mapper.gauge.motion is None:  # else the graph is solved once more, for `RunSnapshot.finished`
            copied.mapper.graph.solver.dismiss_isam()  # it would keep what the run replaces meanwhile
        copied.local_field.free()
        session = self._stored(copied)
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
            loop_decisions=self._loop_decisions,
        )

    @property
    def _loop_decisions(self) -> list[Mapping[str, Any]]:
        """Loop decisions so far, with those of the session that the run continues."""
        return [*(() if self.earlier is None else self.earlier.loop_decisions), *self.statistics.loops]


@immutable
class RunSnapshot:
    """Copy of a run, which shares only what no longer changes: it may be used in another thread.

    session  estimate, to be stored and continued after `finished`, which connects its parts
    summary  of the run so far, for `Finished.summary`
    after    stamp (seconds) after which poses belong to this run
    """

    session: StoredSession
    summary: dict[str, Any]
    after: float

    def finished(self) -> Finished:
        """Return map and trajectory so far. The trajectory has the poses of the scans, but none in between.

        Covariances of walls and corners are those from when each was last seen; those of keyframes are not computed,
        which would take seconds in a large map. Raises MapError if the trajectory has no pose yet.
        """
        state = self.session.slam_state
        mapper = state.mapper
        mapper.gauge.release(mapper)
        walls, corners = map_features(mapper)
        of_walls, of_corners = covariances_when_last_seen(mapper, walls, corners)
        stamps, poses = state.trajectory.at_scans(mapper.keyframe_poses)
        later = stamps > self.after
        if not later.any():
            raise MapError("the robot was not relocalised in the map yet")
        return Finished(
            walls=replace(walls, covariance=of_walls),
            corners=replace(corners, covariance=of_corners),
            keyframes=Keyframes.without_covariance(np.array(state.keyframe_stamps), mapper.keyframe_poses),
            stamps=stamps[later],
            poses=poses[later],
            summary=self.summary,
        )

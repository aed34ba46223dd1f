"""Start of a run: with an empty map, or from the session that it continues."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from drivers import se2

from .config import Config
from .estimation.journal import Journal
from .estimation.placing import INITIAL_POSE_SIGMAS
from .estimation.plan_prior import PlanPrior
from .estimation.slam_state import SlamState
from .loop_closure.agreement import LoopAgreement
from .mapping.plan_map import PlanMap
from .preprocessing.preprocessor import Preprocessor

if TYPE_CHECKING:
    from .io.sessions import StoredSession


def new_state(config: Config, loops: LoopAgreement | None, plan: PlanMap | None, start: se2.Pose | None) -> SlamState:
    """Return the state of a run that starts with an empty map; for the arguments see `Slam`."""
    state = SlamState(config, loops)
    state.plan = None if plan is None else PlanPrior(plan, start, np.diag(INITIAL_POSE_SIGMAS**2))
    return state


def continued_state(config: Config, session: StoredSession) -> SlamState:
    """Return the state of a session, for a run with other settings that continues it."""
    state = session.slam_state
    if session.config.odometry.source != config.odometry.source:
        state.replace_odometry(config)
    state.mapper.gauge.hold(state.mapper)
    state.local_field.rebuild()
    return state


def start_journal(session: StoredSession | None, *, keep_all_features: bool) -> Journal:
    """Return the journal of a run, with the scans and the odometry of the session that it continues."""
    if session is None:
        return Journal(keep_all_features=keep_all_features)
    return Journal(session.scans, session.odometry, session.starts, session.latest, keep_all_features=keep_all_features)


def start_preprocessor(config: Config, session: StoredSession | None) -> Preprocessor:
    """Return the preprocessor of a run, with the noise and the queued scans of the session that it continues."""
    if session is None:
        return Preprocessor(config)
    preprocessor = Preprocessor(config, session.noise, session.second_noise)
    preprocessor.restore_queue(session.queued_scans)
    return preprocessor

"""Start of a run: with an empty map, or from the session that it continues."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers import se2
from drivers.arguments import check_items

from .config import Config
from .errors import ArgumentError, MapError
from .estimation.journal import Journal
from .estimation.placing import INITIAL_POSE_SIGMAS
from .estimation.plan_prior import PlanPrior
from .estimation.slam_state import SlamState
from .events import Sink
from .geometry.segments import Floats
from .io.stored_session import StoredSession
from .loop_closure.agreement import LoopAgreement
from .mapping.plan_map import PlanMap
from .preprocessing.preprocessor import Preprocessor


def check_arguments(
    config: Config | None, sinks: Sequence[Sink], resumed: StoredSession | None, plan: PlanMap | None
) -> None:
    """Raise ArgumentError if an argument of a run has another type, as the name of a file has."""
    types = (
        ("config", config, Config, "load_config reads settings from a file"),
        ("resumed", resumed, StoredSession, "slam.io.sessions.read_session reads it"),
        ("plan", plan, PlanMap, "slam.run takes the name of its file"),
    )
    for name, value, kind, remedy in types:
        if value is not None and not isinstance(value, kind):
            raise ArgumentError(f"{name} must be a {kind.__name__}, not {type(value).__name__}; {remedy}")
    check_items("sinks", sinks, object, "sinks")
    for sink in sinks:
        if not hasattr(sink, "handle"):
            raise ArgumentError(f"a sink must have a method handle(event), which {type(sink).__name__} has not")


def initial_pose(start: Sequence[float] | Floats) -> se2.Pose:
    """Return an initial pose as an array. Raises MapError if it is not three numbers."""
    try:
        pose = np.array(start, dtype=np.float64)
    except (TypeError, ValueError):
        pose = np.zeros(0)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise MapError(f"start: {start!r}: must be three numbers, e.g. [1.5, -2, 3.14]")
    return pose


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

"""Compare a map with a plan: the plan takes the place of an earlier map, its views that of the earlier drive."""

from __future__ import annotations

import numpy as np

from ...config import Config
from ...estimation.slam_state import SlamState
from ...io.sessions import StoredSession
from ...io.sessions.plan_session import plan_session
from ...io.wall_maps import settled_wall_map
from ...mapping.map_features import MapCorners
from ...mapping.plan_map import PlanMap
from ...measuring.wall_map import WallGeometry
from .changes import MapDiff
from .comparison import find_changes
from .surveys import Survey, survey_settled

NO_CORNERS = MapCorners(
    np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), np.int64), np.zeros(0, np.int64)
)
"""Corners of a plan."""
FALSE_DISCOVERY_RATE = 0.05
"""Accepted share of false ones among the differences that a run reports."""


def survey_plan(plan_map: PlanMap, *, searched: bool = False) -> Survey:
    """Return a plan as the survey of an earlier map, in which the errors of walls are independent. Raises MapError.

    searched  true if a map may have to be searched for in it, for which it needs a session

    Lines that are seen from one side are those of a map.
    """
    poses = np.array([view.pose for view in plan_map.views]).reshape(-1, 3)
    points = [np.ascontiguousarray(view.points) for view in plan_map.views]
    bridging = bool(plan_map.plan.one_sided.all())
    # of a wall that is drawn as two lines, the inner sides are hidden, but no walls
    hidden = plan_map.hidden if bridging else None
    session = plan_session(plan_map, Config()) if searched else None
    walls = WallGeometry(plan_map.walls, NO_CORNERS)
    return Survey(session, walls, poses, points, scanned=False, bridging=bridging, hidden=hidden)


def compare_with_plan(plan: Survey, state: SlamState, session: StoredSession) -> tuple[MapDiff, WallGeometry]:
    """Compare the finished map of a run, which is in the plan's frame, with the plan; return its walls, too.

    plan     from `survey_plan`
    state    of the finished run
    session  of the same run, for its scans
    """
    finished = StoredSession(session.config, state, session.scans, (), session.starts, session.noise)
    new = survey_settled(finished, settled_wall_map(state.mapper))
    supported = state.mapper.graph.plan_walls()
    return find_changes(plan, new, np.zeros(3), FALSE_DISCOVERY_RATE, supported), new.wall_map

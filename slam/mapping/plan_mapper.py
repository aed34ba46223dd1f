"""A map under construction made from a plan: its walls as landmarks, its views as keyframes at exactly known poses.

The views observe the plan's walls with so much noise that all of them together leave each wall as uncertain as the
plan.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import MapError
from ..geometry.segments import CornerPoints
from ..graph.factor_graph import FIRST_POSE_SIGMAS
from .keyframes import KeyframeMotion, LandmarkIds
from .landmarks import Landmarks
from .mapper import Mapper
from .plan_map import PlanMap
from .unconfirmed_observations import CONFIRMING_KEYFRAMES
from .wall_cells import cells_between

# Views that a map consists of at least. Origin: definition, as many as confirm a wall.
MIN_VIEWS = 2
# A plan states no corners: they follow from its walls. Origin: definition.
NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))


def plan_mapper(plan_map: PlanMap) -> Mapper:
    """Return a map with a keyframe for each view of a plan, and the plan's walls with their prior covariance.

    Raises MapError if the plan shows too little for a map.
    """
    views, walls = plan_map.views, plan_map.walls
    name = plan_map.plan.name
    if len(views) < MIN_VIEWS or not len(walls):
        raise MapError(f"{name}: has no room: a robot must fit between walls, with most of them in view")
    mapper = Mapper(_landmarks(plan_map))
    counts = mapper.landmarks.walls.rows["observations"].copy()
    exact = np.diag(FIRST_POSE_SIGMAS**2)
    for k, view in enumerate(views):
        motion = None if k == 0 else KeyframeMotion(k - 1, view.pose - views[k - 1].pose, exact)
        shared = replace(
            view.segments, covariance=view.segments.covariance * counts[view.walls][:, None, None].astype(float)
        )
        ids = LandmarkIds(view.walls, np.zeros(0, dtype=np.int64))
        mapper.add_keyframe_with_ids(view.pose, motion, shared, NO_CORNERS, ids)
    mapper.solve()
    mapper.recompute_pose_covariances()
    everything = np.arange(len(walls))
    mapper.landmarks.set_wall_covariances(everything, walls.covariance, walls.covariance)
    return mapper


def _landmarks(plan_map: PlanMap) -> Landmarks:
    """Return the walls as landmarks that no keyframe is in the graph with yet."""
    landmarks, walls = Landmarks(), plan_map.walls
    for wall in range(len(walls)):
        landmarks.add_wall(walls.frame[wall], 0.5 * float(walls.high[wall] - walls.low[wall]), 0)
    rows = landmarks.walls.rows
    rows["low"], rows["high"] = walls.low, walls.high
    for wall, pieces in enumerate(walls.pieces):
        landmarks.covered[wall] = frozenset().union(*(cells_between(low, high) for low, high in pieces.tolist()))
    for k, view in enumerate(plan_map.views):
        rows["last_seen"][view.walls] = k
    rows["observations"] = np.maximum(walls.observations, CONFIRMING_KEYFRAMES)
    return landmarks

"""Rebuild a factor graph with a part of it moved rigidly, or without some walls.

Gauss-Newton moves variables along straight lines from where they were linearised: it does not turn a part of the map by
a right angle. So the part is moved first. All of its factors are relative to its own variables and stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers import se2

from ..geometry.segments import Floats, Integers
from .factor_graph import FactorGraph
from .factors import Factor, walls_of
from .graph_storage import graph_state, restore_graph


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """Motion [x, y, heading] in the map of some keyframes, walls and corners, by their numbers."""

    motion: se2.Pose
    keyframes: Integers
    walls: Integers
    corners: Integers


def rebuild(
    graph: FactorGraph, moved: RigidMotion, remove: Callable[[Factor], bool], add: Sequence[Factor]
) -> FactorGraph:
    """Return the graph with some variables moved, without the factors for which `remove` is true, and with others.

    Raises MapError if this leaves a variable undetermined.
    """
    state = graph_state(graph)
    return restore_graph(
        replace(
            state,
            factors=[*(factor for factor in state.factors if not remove(factor)), *add],
            keyframes=_moved_poses(
                moved.motion, state.keyframes, np.isin(np.arange(len(state.keyframes)), moved.keyframes)
            ),
            frames=_moved_poses(moved.motion, state.frames, np.isin(state.walls, moved.walls)),
            positions=_moved_points(moved.motion, state.positions, np.isin(state.corners, moved.corners)),
            point_map_poses=_moved_poses(
                moved.motion, state.point_map_poses, np.isin(state.point_maps, moved.keyframes)
            ),
        )
    )


def without_walls(graph: FactorGraph, walls: Iterable[int]) -> FactorGraph:
    """Return the graph without some walls and all factors that contain them.

    Raises MapError if this leaves a variable undetermined.
    """
    state, gone = graph_state(graph), set(walls)
    kept = np.array([wall not in gone for wall in state.walls.tolist()], dtype=bool)
    return restore_graph(
        replace(
            state,
            factors=[factor for factor in state.factors if gone.isdisjoint(walls_of(factor))],
            walls=state.walls[kept],
            frames=state.frames[kept],
        )
    )


def _moved_poses(motion: se2.Pose, poses: Floats, which: np.ndarray) -> Floats:
    result = poses.copy()
    result[which] = se2.compose(motion, poses[which])
    return result


def _moved_points(motion: se2.Pose, points: Floats, which: np.ndarray) -> Floats:
    result = points.copy()
    result[which] = se2.transform(motion, points[which])
    return result

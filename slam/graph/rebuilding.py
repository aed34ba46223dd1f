"""Rebuild a factor graph with a part of it moved rigidly, without some walls, or with passes that share no landmark.

Gauss-Newton moves variables along straight lines from where they were linearised: it does not turn a part of the map by
a right angle. So the part is moved first. All of its factors are relative to its own variables and stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from .factor_graph import GAUGE_PRIOR_SIGMA, FactorGraph
from .factors import OBSERVATION_KINDS, Factor, FactorKind, GraphState, walls_of
from .graph_storage import graph_state, restore_graph


@immutable
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

    Keyframes that wait for the next update of the graph still do. Raises MapError if this leaves a variable
    undetermined.
    """
    state = graph_state(graph)
    return restore_graph(
        replace(
            _with_factors(state, lambda factor: None if remove(factor) else factor, add),
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
            _with_factors(state, lambda factor: factor if gone.isdisjoint(walls_of(factor)) else None),
            walls=state.walls[kept],
            frames=state.frames[kept],
        )
    )


@immutable
class LandmarkCopy:
    """Landmark `copy` that gets the observations of the landmark `original` by some keyframes."""

    original: int
    copy: int
    keyframes: frozenset[int]


def with_copies(
    graph: FactorGraph,
    walls: Sequence[LandmarkCopy],
    corners: Sequence[LandmarkCopy],
    remove: Callable[[Factor], bool],
    add: Sequence[Factor],
) -> FactorGraph:
    """Return the graph with copies of landmarks, without the factors for which `remove` is true, and with others.

    The copies are where the originals are. Each original keeps at least one observation. Raises MapError if a variable
    is left undetermined.
    """
    state = graph_state(graph)
    of_walls = {(keyframe, one.original): one.copy for one in walls for keyframe in one.keyframes}
    of_corners = {(keyframe, one.original): one.copy for one in corners for keyframe in one.keyframes}
    frames = dict(zip(state.walls.tolist(), state.frames, strict=True))
    positions = dict(zip(state.corners.tolist(), state.positions, strict=True))
    poses = state.keyframes
    gauge = [
        _gauge_prior(first, one.copy, se2.between(poses[first], frames[one.original]))
        for one in walls
        for first in [min(one.keyframes)]
    ]

    def change(factor: Factor) -> Factor | None:
        return None if remove(factor) else _of_copy(factor, of_walls, of_corners)

    return restore_graph(
        replace(
            _with_factors(state, change, [*gauge, *add]),
            walls=np.array([*frames, *(one.copy for one in walls)], dtype=np.int64),
            frames=np.array([*frames.values(), *(frames[one.original] for one in walls)]).reshape(-1, 3),
            corners=np.array([*positions, *(one.copy for one in corners)], dtype=np.int64),
            positions=np.array([*positions.values(), *(positions[one.original] for one in corners)]).reshape(-1, 2),
        )
    )


def _with_factors(
    state: GraphState, change: Callable[[Factor], Factor | None], add: Sequence[Factor] = ()
) -> GraphState:
    """Return a state with changed factors, without those for which `change` returns None, and with others.

    Factors that wait for the next update, the last ones, still do. The others and `add` do not.
    """
    changed = [change(factor) for factor in state.factors]
    solved = len(changed) - state.waiting
    waiting = [factor for factor in changed[solved:] if factor is not None]
    known = [factor for factor in changed[:solved] if factor is not None]
    return replace(state, factors=[*known, *add, *waiting], waiting=len(waiting))


def _gauge_prior(keyframe: int, wall: int, predicted: se2.Pose) -> Factor:
    """Return the prior that fixes a wall weakly along itself at `predicted`, its frame as seen from a keyframe."""
    return Factor(FactorKind.GAUGE_PRIOR, keyframe, wall, predicted, np.array([[GAUGE_PRIOR_SIGMA**2]]))


def _of_copy(factor: Factor, walls: Mapping[tuple[int, int], int], corners: Mapping[tuple[int, int], int]) -> Factor:
    """Return an observation of a landmark as one of its copy, if it is by a keyframe that observes the copy."""
    if factor.kind in OBSERVATION_KINDS:
        return replace(factor, second=walls.get((factor.first, factor.second), factor.second))
    if factor.kind is FactorKind.CORNER:
        return replace(factor, second=corners.get((factor.first, factor.second), factor.second))
    return factor


def _moved_poses(motion: se2.Pose, poses: Floats, which: np.ndarray) -> Floats:
    result = poses.copy()
    result[which] = se2.compose(motion, poses[which])
    return result


def _moved_points(motion: se2.Pose, points: Floats, which: np.ndarray) -> Floats:
    result = points.copy()
    result[which] = se2.transform(motion, points[which])
    return result

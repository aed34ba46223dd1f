"""Convert a session's factor graph to a pose graph, for programs that optimise those.

Nothing is left out: keyframes, walls and the points of keyframes become poses, corners become landmarks, and each
factor becomes an edge. An edge to a wall has no information along the wall. The information of an edge is multiplied by
its robust weight at the estimate, so plain least squares has its optimum at the session's estimate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ...geometry.segments import Floats
from ...graph.factors import CAUCHY_SCALES, PIN_KINDS, WALL_KINDS, Factor, FactorKind, FactorsOfKind, by_kind
from ...graph.graph_storage import graph_state
from ...graph.pose_graph import Edges, PoseGraph
from ...mapping.mapper import Mapper

FIRST_WALL_ID = 1_000_000
"""Vertex id of wall 0; keyframes start at 0."""
FIRST_CORNER_ID = 2_000_000
"""Vertex id of corner 0."""
FIRST_POINT_MAP_ID = 3_000_000
"""Vertex id of the points of keyframe 0."""
PLAN_ID = 4_000_000
"""Vertex id of the frame of a plan or a survey, which is that of the map."""


def build_pose_graph(mapper: Mapper) -> PoseGraph:
    """Return the pose graph of a mapper that has converged, at its estimate.

    The first keyframe is fixed; in a map with a plan or with pins, the frame of these instead.
    """
    state, count = graph_state(mapper.graph), mapper.keyframe_count
    wall_frames, point_maps = mapper.graph.wall_frames(state.walls.tolist()), state.point_maps.tolist()
    in_frame = (FactorKind.PLAN_WALL, *PIN_KINDS)
    plan = [PLAN_ID] if any(factor.kind in in_frame for factor in state.factors) else []
    poses = np.concatenate(
        [
            mapper.graph.keyframe_poses(count),
            wall_frames,
            mapper.graph.point_map_poses(point_maps),
            np.zeros((len(plan), 3)),
        ]
    )
    landmarks = mapper.graph.corner_positions(state.corners.tolist())
    walls = {int(wall): count + row for row, wall in enumerate(state.walls)}
    bodies = {keyframe: count + len(walls) + row for row, keyframe in enumerate(point_maps)}
    corners = {int(corner): row for row, corner in enumerate(state.corners)}
    motions = [factor for factor in state.factors if factor.kind not in (FactorKind.POSE_PRIOR, FactorKind.CORNER)]
    motion_ends = [_rows_of(factor, walls, bodies, len(poses) - 1) for factor in motions]
    positions = [factor for factor in state.factors if factor.kind is FactorKind.CORNER]
    position_ends = [(factor.first, corners[factor.second]) for factor in positions]
    no_edges = Edges(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 1)), np.zeros((0, 1, 1)), np.zeros(0, int))
    return PoseGraph(
        pose_ids=np.concatenate(
            [
                np.arange(count),
                FIRST_WALL_ID + state.walls,
                FIRST_POINT_MAP_ID + state.point_maps,
                np.array(plan, dtype=np.int64),
            ]
        ),
        poses=poses,
        landmark_ids=FIRST_CORNER_ID + state.corners,
        landmarks=landmarks,
        motions=_build_edges(motions, motion_ends, poses, poses, 3, state.bias),
        positions=_build_edges(positions, position_ends, poses, landmarks, 2, state.bias),
        bearings=no_edges,
        fixed_poses=np.arange(len(poses)) == (len(poses) - 1 if plan else 0),
        fixed_landmarks=np.zeros(len(landmarks), dtype=bool),
    )


def _rows_of(factor: Factor, walls: Mapping[int, int], bodies: Mapping[int, int], plan: int) -> tuple[int, int]:
    """Return the rows of the poses at both ends of a factor.

    Given are those of the walls, of the keyframes' points, and of the frame of the plan or the survey.
    """
    match factor.kind:
        case FactorKind.ODOMETRY | FactorKind.LOOP | FactorKind.SUBMAP_MATCH:
            return factor.first, factor.second
        case FactorKind.POINT_MAP:
            return factor.first, bodies[factor.second]
        case FactorKind.SCAN_MATCH:
            return bodies[factor.first], factor.second
        case FactorKind.PINNED_POSE:
            return plan, factor.second
        case FactorKind.PLAN_WALL | FactorKind.PINNED_WALL:
            return plan, walls[factor.second]
        case FactorKind.WALL_EQUALITY:
            return walls[factor.first], walls[factor.second]
        case _:
            return factor.first, walls[factor.second]


def _build_edges(
    factors: Sequence[Factor],
    ends: Sequence[tuple[int, int]],
    sources: Floats,
    targets: Floats,
    size: Literal[2, 3],
    bias: float,
) -> Edges:
    """Return an edge for each factor, with its robust weight at the estimates (n, 3) and (m, `size`) of its ends.

    bias  estimate of the range bias (metres), without which the measurements are exported
    """
    rows = np.array(ends, dtype=np.int64).reshape(-1, 2)
    measured, information = np.zeros((len(factors), size)), np.zeros((len(factors), size, size))
    for group in by_kind(factors):
        measured[group.rows] = group.without_range_bias(bias)[:, :size]
        information[group.rows] = _information(group)
    errors = _errors(sources[rows[:, 0]], targets[rows[:, 1]], measured)
    squared = np.einsum("ki,kij,kj->k", errors, information, errors)
    scale = np.array([CAUCHY_SCALES.get(factor.kind, np.inf) for factor in factors])
    weight = 1.0 / (1.0 + squared / scale**2)
    information *= weight[:, None, None]
    return Edges(rows[:, 0], rows[:, 1], measured, information, np.zeros(len(factors), dtype=np.int64))


def _information(group: FactorsOfKind) -> Floats:
    """Return the information (n, d, d) of measurements of one kind; that of factors on a wall is singular."""
    if group.kind not in WALL_KINDS:
        return np.asarray(np.linalg.inv(group.covariances))
    root = group.roots_of_information()
    return np.asarray(root.transpose(0, 2, 1) @ root)


def _errors(sources: Floats, targets: Floats, measured: Floats) -> NDArray[np.float64]:
    """Return the errors (k, d) of k measurements at the estimate, as g2o defines them."""
    if measured.shape[1] == 2:
        return np.asarray(se2.transform(se2.inverse(sources), targets) - measured).reshape(-1, 2)
    return se2.between(measured, se2.between(sources, targets)).reshape(-1, 3)

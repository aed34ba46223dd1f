"""Convert a session's factor graph to a pose graph, for programs that optimise those.

Nothing is left out: keyframes and walls become poses, corners become landmarks, and each factor becomes an edge. An
edge to a wall has no information along the wall. The information of an edge is multiplied by its robust weight at the
estimate, so plain least squares has its optimum at the session's estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ...geometry.segments import Floats
from ...graph.factors import CAUCHY_SCALES, Factor, FactorKind, root_information
from ...graph.pose_graph import Edges, PoseGraph
from ...mapping.mapper import Mapper

FIRST_WALL_ID = 1_000_000
"""Vertex id of wall 0; keyframes start at 0."""
FIRST_CORNER_ID = 2_000_000
"""Vertex id of corner 0."""
KEYFRAME_KINDS = (FactorKind.ODOMETRY, FactorKind.LOOP, FactorKind.SCAN_MATCH)
"""Factors between two keyframes."""
WALL_KINDS = (FactorKind.GAUGE_PRIOR, FactorKind.WALL_HEADING, FactorKind.WALL_OFFSET, FactorKind.WALL_EQUALITY)
"""Factors on a wall, whose information is singular."""


def build_pose_graph(mapper: Mapper) -> PoseGraph:
    """Return the pose graph of a mapper that has converged, at its estimate; the first keyframe is fixed."""
    state, count = mapper.graph.state(), mapper.keyframe_count
    poses = np.concatenate([mapper.graph.keyframe_poses(count), mapper.graph.wall_frames(state.walls.tolist())])
    landmarks = mapper.graph.corner_positions(state.corners.tolist())
    walls = {int(wall): count + row for row, wall in enumerate(state.walls)}
    corners = {int(corner): row for row, corner in enumerate(state.corners)}
    motions = [factor for factor in state.factors if factor.kind not in (FactorKind.POSE_PRIOR, FactorKind.CORNER)]
    first = [walls[factor.first] if factor.kind is FactorKind.WALL_EQUALITY else factor.first for factor in motions]
    second = [factor.second if factor.kind in KEYFRAME_KINDS else walls[factor.second] for factor in motions]
    positions = [factor for factor in state.factors if factor.kind is FactorKind.CORNER]
    position_ends = [(factor.first, corners[factor.second]) for factor in positions]
    no_edges = Edges(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 1)), np.zeros((0, 1, 1)), np.zeros(0, int))
    return PoseGraph(
        pose_ids=np.concatenate([np.arange(count), FIRST_WALL_ID + state.walls]),
        poses=poses,
        landmark_ids=FIRST_CORNER_ID + state.corners,
        landmarks=landmarks,
        motions=_build_edges(motions, list(zip(first, second, strict=True)), poses, poses, 3),
        positions=_build_edges(positions, position_ends, poses, landmarks, 2),
        bearings=no_edges,
        fixed_poses=np.arange(len(poses)) == 0,
        fixed_landmarks=np.zeros(len(landmarks), dtype=bool),
    )


def _build_edges(
    factors: Sequence[Factor], ends: Sequence[tuple[int, int]], sources: Floats, targets: Floats, size: Literal[2, 3]
) -> Edges:
    """Return an edge for each factor, with its robust weight at the estimates (n, 3) and (m, `size`) of its ends."""
    rows = np.array(ends, dtype=np.int64).reshape(-1, 2)
    measured = np.array([factor.measured[:size] for factor in factors]).reshape(-1, size)
    information = np.zeros((len(factors), size, size))
    for row, factor in enumerate(factors):
        information[row] = _information(factor)
    errors = _errors(sources[rows[:, 0]], targets[rows[:, 1]], measured)
    squared = np.einsum("ki,kij,kj->k", errors, information, errors)
    scale = np.array([CAUCHY_SCALES.get(factor.kind, np.inf) for factor in factors])
    weight = 1.0 / (1.0 + squared / scale**2)
    information *= weight[:, None, None]
    return Edges(rows[:, 0], rows[:, 1], measured, information, np.zeros(len(factors), dtype=np.int64))


def _information(factor: Factor) -> Floats:
    """Return the information of a factor's measurement; that of a factor on a wall is singular."""
    if factor.kind not in WALL_KINDS:
        return np.asarray(np.linalg.inv(factor.covariance))
    root = root_information(factor)
    return np.asarray(root.T @ root)


def _errors(sources: Floats, targets: Floats, measured: Floats) -> NDArray[np.float64]:
    """Return the errors (k, d) of k measurements at the estimate, as g2o defines them."""
    if measured.shape[1] == 2:
        return np.asarray(se2.transform(se2.inverse(sources), targets) - measured).reshape(-1, 2)
    return se2.between(measured, se2.between(sources, targets)).reshape(-1, 3)

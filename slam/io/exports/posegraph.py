"""A session's factor graph for programs that optimise pose graphs.

Nothing is left out or summarised: keyframes and walls are poses, corners are landmarks, each factor is an edge. An edge
to a wall has no information along it. What the kernels take from the weight of an edge, at the estimate, is taken from
its information: so plain least squares has its optimum where the session has it.
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

FIRST_WALL = 1_000_000
"""What is added to a wall's identity to have its id: keyframes come from 0 on."""
FIRST_CORNER = 2_000_000
BETWEEN_KEYFRAMES = (FactorKind.MOTION, FactorKind.LOOP)
OF_WALLS = (FactorKind.GAUGE_PRIOR, FactorKind.HEADING, FactorKind.OFFSET, FactorKind.WALL_EQUALITY)


def pose_graph_of(mapper: Mapper) -> PoseGraph:
    """The graph of a mapper that has settled, with its estimate. The first keyframe stays where it is."""
    state, count = mapper.graph.state(), mapper.keyframe_count
    poses = np.concatenate([mapper.graph.keyframe_poses(count), mapper.graph.wall_frames(state.walls.tolist())])
    landmarks = mapper.graph.corner_positions(state.corners.tolist())
    walls = {int(wall): count + row for row, wall in enumerate(state.walls)}
    corners = {int(corner): row for row, corner in enumerate(state.corners)}
    motions = [factor for factor in state.factors if factor.kind not in (FactorKind.START, FactorKind.CORNER)]
    first = [walls[factor.first] if factor.kind is FactorKind.WALL_EQUALITY else factor.first for factor in motions]
    second = [factor.second if factor.kind in BETWEEN_KEYFRAMES else walls[factor.second] for factor in motions]
    seen = [factor for factor in state.factors if factor.kind is FactorKind.CORNER]
    seen_ends = [(factor.first, corners[factor.second]) for factor in seen]
    nothing = Edges(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 1)), np.zeros((0, 1, 1)), np.zeros(0, int))
    return PoseGraph(
        pose_ids=np.concatenate([np.arange(count), FIRST_WALL + state.walls]),
        poses=poses,
        landmark_ids=FIRST_CORNER + state.corners,
        landmarks=landmarks,
        motions=_edges(motions, list(zip(first, second, strict=True)), poses, poses, 3),
        positions=_edges(seen, seen_ends, poses, landmarks, 2),
        bearings=nothing,
        fixed_poses=np.arange(len(poses)) == 0,
        fixed_landmarks=np.zeros(len(landmarks), dtype=bool),
    )


def _edges(
    factors: Sequence[Factor], ends: Sequence[tuple[int, int]], sources: Floats, targets: Floats, size: Literal[2, 3]
) -> Edges:
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
    """Of what a factor measures; on a wall it has none of some directions."""
    if factor.kind not in OF_WALLS:
        return np.asarray(np.linalg.inv(factor.covariance))
    root = root_information(factor)
    return np.asarray(root.T @ root)


def _errors(sources: Floats, targets: Floats, measured: Floats) -> NDArray[np.float64]:
    """(k, d): how far what is measured is from the estimate, as g2o has it."""
    if measured.shape[1] == 2:
        return np.asarray(se2.transform(se2.inverse(sources), targets) - measured).reshape(-1, 2)
    return se2.between(measured, se2.between(sources, targets)).reshape(-1, 3)

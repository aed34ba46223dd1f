"""Convert a factor graph into plain data that can be stored, and restore it."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, P, X

from ..geometry.segments import Floats
from .factor_graph import Additions, FactorGraph
from .factors import GraphState, by_kind
from .gtsam_factors import from_pose2, to_pose2
from .isam2 import IncrementalSolver
from .range_bias import RangeBias


def graph_state(graph: FactorGraph) -> GraphState:
    """Return everything a graph consists of as plain data, with what waits for its next update."""
    solver, additions = graph.solver, graph.additions
    values = gtsam.Values(solver.linearisation_point())
    values.insert(additions.values)
    keys: dict[str, list[int]] = {"x": [], "l": [], "c": [], "p": []}
    for key in sorted(values.keys()):
        symbol = gtsam.Symbol(key)
        keys[chr(symbol.chr())].append(symbol.index())
    return GraphState(
        factors=[*solver.sorted_factors(), *additions.factors],
        keyframes=np.array([from_pose2(values.atPose2(X(k))) for k in keys["x"]]).reshape(-1, 3),
        walls=np.array(keys["l"], dtype=np.int64),
        frames=np.array([from_pose2(values.atPose2(L(j))) for j in keys["l"]]).reshape(-1, 3),
        corners=np.array(keys["c"], dtype=np.int64),
        positions=np.array([values.atPoint2(C(j)) for j in keys["c"]]).reshape(-1, 2),
        point_maps=np.array(keys["p"], dtype=np.int64),
        point_map_poses=np.array([from_pose2(values.atPose2(P(k))) for k in keys["p"]]).reshape(-1, 3),
        updates=solver.updates,
        qr=solver.qr,
        bias=solver.range_bias.metres,
        waiting=len(additions.factors),
    )


def restore_graph(state: GraphState) -> FactorGraph:
    """Restore a graph. The estimate follows from its factors and linearisation points.

    Raises MapError if the state leaves a variable undetermined.
    """
    graph = FactorGraph()
    graph.solver = IncrementalSolver(qr=state.qr)
    graph.solver.range_bias = RangeBias(state.bias)
    solved = len(state.factors) - state.waiting
    known, waiting = Additions(list(state.factors[:solved])), Additions(list(state.factors[solved:]))
    used = {key for group in by_kind(known.factors) for keys in group.keys.tolist() for key in keys}
    for key, value in _variables(state).items():
        (known if key in used else waiting).values.insert(key, value)
    graph.solver.restore(known.factors, known.values, state.updates)
    graph.additions = waiting
    return graph


def _variables(state: GraphState) -> dict[int, gtsam.Pose2 | Floats]:
    """Return the linearisation point of each variable by its key."""
    groups = (
        (X, range(len(state.keyframes)), state.keyframes),
        (L, state.walls.tolist(), state.frames),
        (P, state.point_maps.tolist(), state.point_map_poses),
    )
    poses = {key(k): to_pose2(pose) for key, ids, of_ids in groups for k, pose in zip(ids, of_ids, strict=True)}
    return poses | {C(k): position for k, position in zip(state.corners.tolist(), state.positions, strict=True)}

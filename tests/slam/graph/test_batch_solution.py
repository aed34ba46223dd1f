"""A batch solution in place of the incremental solver: the same estimate and covariances, before and after changes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from gtsam.symbol_shorthand import C, L, P, X

from drivers import se2
from slam.graph.factor_graph import FactorGraph
from slam.graph.final_solution import solve_with_range_bias
from slam.graph.graph_storage import graph_state

from .test_array_graph import graph_of_all_kinds


def solved_graph() -> FactorGraph:
    """Return a graph whose optimum is found."""
    graph = graph_of_all_kinds(np.random.default_rng(4))
    for _ in range(5):
        solve_with_range_bias(graph)
    return graph


def incremental(graph: FactorGraph) -> FactorGraph:
    """Return a copy of a graph that is solved by iSAM2."""
    graph = graph.__deepcopy__({})
    assert graph.solver.isam is graph.solver.isam
    assert graph.solver.batch is None
    return graph


def add_keyframe(graph: FactorGraph) -> None:
    pose = graph.keyframe_pose(2)
    graph.add_keyframe(3, se2.compose(pose, [0.5, 0.0, 0.1]), 2, np.array([0.5, 0.0, 0.1]), 1e-4 * np.eye(3))


QUERIES: list[Callable[[FactorGraph], object]] = [
    lambda graph: graph.keyframe_poses(3),
    lambda graph: graph.wall_frames([2, 0]),
    lambda graph: graph.corner_positions([0]),
    lambda graph: graph.point_map_poses([0]),
    lambda graph: graph.chi2(),
    lambda graph: graph.degrees_of_freedom(),
    lambda graph: graph.keyframe_covariance(1),
    lambda graph: graph.relative_covariance(0, 2),
    lambda graph: graph.wall_covariances([[0, 2], [1]])[0],
    lambda graph: graph.marginals().walls([0, 1, 2]),
    lambda graph: graph.relative_covariances([1, 2], [0], [0]).corners,
    lambda graph: graph.solver.joint_covariance([L(1), C(0), X(2), P(0)]),
]


@pytest.mark.parametrize("query", QUERIES)
def test_answers_are_those_of_the_incremental_solver(query: Callable[[FactorGraph], object]) -> None:
    graph = solved_graph()
    answer = query(graph)
    assert graph.solver.batch is not None
    np.testing.assert_allclose(answer, query(incremental(graph)), rtol=1e-5, atol=1e-7)


def test_wall_equalities_are_added_as_by_the_incremental_solver() -> None:
    """Within a millimetre or so: iSAM2 leaves out smaller steps."""
    graph = solved_graph()
    expected = incremental(graph)
    for one in (graph, expected):
        one.add_wall_equality(1, 2, 0.5)
        one.update_until_converged()
    assert graph.solver.batch is not None
    assert graph.factor_count == expected.factor_count
    np.testing.assert_allclose(graph.keyframe_poses(3), expected.keyframe_poses(3), atol=2e-3)


def test_a_graph_with_new_keyframes_is_solved_incrementally() -> None:
    graph = solved_graph()
    expected = incremental(graph)
    for one in (graph, expected):
        add_keyframe(one)
        one.update()
    assert graph.solver.batch is None
    np.testing.assert_allclose(graph.keyframe_poses(4), expected.keyframe_poses(4), atol=1e-9)


def test_a_dismissed_solver_is_built_again() -> None:
    graph = graph_of_all_kinds(np.random.default_rng(4))
    before, poses = graph_state(graph), graph.keyframe_poses(3)
    graph.solver.dismiss_isam()
    after = graph_state(graph)
    np.testing.assert_array_equal(after.keyframes, before.keyframes)
    np.testing.assert_array_equal(after.frames, before.frames)
    assert (after.updates, len(after.factors)) == (before.updates, len(before.factors))
    np.testing.assert_allclose(graph.keyframe_poses(3), poses, atol=1e-9)
    add_keyframe(graph)
    graph.update()
    assert graph.keyframe_poses(4).shape == (4, 3)

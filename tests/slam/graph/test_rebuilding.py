"""Rebuilt graphs have the same variables, and the same of them wait for the next update."""

import numpy as np
import pytest

from drivers import se2
from slam.graph.factor_graph import FactorGraph
from slam.graph.factors import Factor, FactorKind
from slam.graph.rebuilding import RigidMotion, rebuild, without_walls

MOTION, COVARIANCE = np.array([1.0, 0.1, 0.2]), np.diag([1e-4, 1e-4, 1e-5])
WEAK = np.diag([100.0, 100.0, 9.0])
NONE = np.zeros(0, np.int64)


@pytest.fixture
def graph() -> FactorGraph:
    """Three keyframes in two parts, two walls, and what waits: the fourth keyframe, and that the walls are one."""
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    graph.add_first_keyframe(np.array([5.0, 0.0, 0.0]), 1)
    graph.add_keyframe(2, np.array([6.0, 0.1, 0.2]), 1, MOTION, COVARIANCE)
    for wall, y in enumerate((1.0, 1.01)):
        frame = np.array([5.0, y, 0.0])
        seen = se2.between(np.array([5.0, 0.0, 0.0]), frame)
        graph.add_wall(1, wall, frame, seen)
        graph.add_wall_observation(1, wall, seen, np.diag([1e-4, 1e-5]), seen)
    graph.update()
    graph.add_wall_equality(0, 1, 0.0)
    graph.add_keyframe(3, se2.compose(graph.keyframe_pose(2), MOTION), 2, MOTION, COVARIANCE)
    return graph


def test_a_part_is_connected_by_a_weak_factor_while_others_wait(graph: FactorGraph) -> None:
    motion = np.array([5.0, 0.0, 0.0])
    weak = Factor(FactorKind.ODOMETRY, 0, 1, motion, WEAK)
    moved = RigidMotion(np.zeros(3), NONE, NONE, NONE)
    rebuilt = rebuild(graph, moved, lambda f: f.kind is FactorKind.POSE_PRIOR and f.first == 1, [weak])
    assert [rebuilt.is_waiting(k) for k in range(4)] == [False, False, False, True]
    np.testing.assert_allclose(np.diag(rebuilt.keyframe_covariance(1))[:2], [100.0, 100.0], rtol=0.1)
    rebuilt.update()
    expected = [se2.compose(motion, np.zeros(3)), graph.keyframe_pose(2), graph.keyframe_pose(3)]
    np.testing.assert_allclose(rebuilt.keyframe_poses(4)[1:], expected, atol=1e-3)


def test_a_wall_that_waits_for_a_decision_can_be_removed(graph: FactorGraph) -> None:
    rebuilt = without_walls(graph, [1])
    assert [rebuilt.is_waiting(k) for k in range(4)] == [False, False, False, True]
    assert [factor.kind for factor in rebuilt.additions.factors] == [FactorKind.ODOMETRY]
    rebuilt.update()
    np.testing.assert_allclose(rebuilt.keyframe_poses(4), graph.keyframe_poses(4), atol=1e-3)

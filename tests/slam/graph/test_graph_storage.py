"""A restored graph has the estimate of the stored one, and keeps the same one with later keyframes."""

import numpy as np
import pytest

from drivers import se2
from slam.graph.factor_graph import FactorGraph
from slam.graph.graph_storage import graph_state, restore_graph
from slam.graph.gtsam_isam2 import RELINEARIZE_SKIP

MOTION, COVARIANCE = np.array([1.0, 0.1, 0.2]), np.diag([1e-4, 1e-4, 1e-5])
WRONG_TURN = np.array([0.0, 0.0, 0.3])
"""Error of each motion when its keyframe is added, in radians more than any threshold to relinearise."""


def drive_on(graph: FactorGraph, first: int, last: int) -> None:
    """Add some keyframes with wrong initial values, and solve the graph with all of them."""
    for k in range(first, last):
        start = graph.keyframe_pose(k - 1)
        graph.add_keyframe(k, se2.compose(start, MOTION + WRONG_TURN), k - 1, MOTION, COVARIANCE)
    graph.update()


@pytest.mark.parametrize("updates", range(1, 2 * RELINEARIZE_SKIP + 1))
def test_a_restored_graph_goes_on_from_where_it_was(updates: int) -> None:
    """The last update before has moved variables far from where they were linearised, and the next may relinearise."""
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    for _ in range(updates - 1):
        graph.update()
    drive_on(graph, 1, 5)
    restored = restore_graph(graph_state(graph))
    np.testing.assert_allclose(restored.keyframe_poses(5), graph.keyframe_poses(5), atol=1e-9)
    for last in range(6, 6 + RELINEARIZE_SKIP):
        for one in (graph, restored):
            drive_on(one, last - 1, last)
        np.testing.assert_allclose(restored.keyframe_poses(last), graph.keyframe_poses(last), atol=1e-9)

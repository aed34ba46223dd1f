"""Keyframes that wait until the graph is solved with them."""

import numpy as np
import pytest

import drivers
from slam import Slam
from slam.mapping.mapper import Mapper
from slam.mapping.waiting_keyframes import SOLVE_DISTANCE


@pytest.fixture(scope="module")
def slam() -> Slam:
    """A run in which keyframes wait."""
    slam, longest, farthest = Slam(), 0, 0.0
    for message in drivers.open("sim:office?duration=12&seed=3&lidar=short"):
        slam.add(message)
        waiting, distance = _waiting(slam.slam_state.mapper)
        longest, farthest = max(longest, waiting), max(farthest, distance)
        if waiting == 2 and slam.slam_state.mapper.keyframe_count > 10:
            break
    assert longest > 1
    assert 0.0 < farthest < SOLVE_DISTANCE
    return slam


def _waiting(mapper: Mapper) -> tuple[int, float]:
    """Return how many keyframes wait, and the metres driven since the last one that does not."""
    waiting = [k for k in range(mapper.keyframe_count) if mapper.graph.is_waiting(k)]
    return len(waiting), mapper.travelled[-1] - mapper.travelled[waiting[0] - 1] if waiting else 0.0


def test_a_waiting_keyframe_has_a_pose_and_a_covariance(slam: Slam) -> None:
    mapper = slam.slam_state.mapper
    last = mapper.keyframe_count - 1
    np.testing.assert_allclose(mapper.graph.keyframe_poses(last + 1)[-1], mapper.pose, rtol=0.0, atol=1e-12)
    assert np.linalg.eigvalsh(slam.keyframe_covariance(last))[0] > 0.0


def test_a_copy_has_the_waiting_keyframes_and_does_not_change_the_original(slam: Slam) -> None:
    mapper = slam.slam_state.mapper
    before, waiting = mapper.keyframe_poses.copy(), _waiting(mapper)
    copies = [slam.slam_state.copy().mapper for _ in range(2)]
    for copy in copies:
        copy.solve_waiting()
        assert copy.is_solved
    assert np.array_equal(copies[0].keyframe_poses, copies[1].keyframe_poses)
    assert not np.array_equal(copies[0].keyframe_poses[-2:], before[-2:])
    assert np.array_equal(mapper.keyframe_poses, before)
    assert _waiting(mapper) == waiting


def test_solving_hardly_moves_waiting_keyframes(slam: Slam) -> None:
    mapper = slam.slam_state.copy().mapper
    tracked = mapper.pose
    sigmas = np.sqrt(np.diag(mapper.covariances.of_last()))
    mapper.solve_waiting()
    assert (np.abs(mapper.pose - tracked) < 3.0 * (sigmas + np.array([0.01, 0.01, 0.002]))).all()

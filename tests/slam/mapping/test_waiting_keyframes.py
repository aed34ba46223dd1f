"""Keyframes that wait until the graph is solved with them."""

import numpy as np
import pytest

import drivers
from slam import Slam
from slam.geometry.segments import Segments
from slam.mapping.keyframes import LandmarkIds
from slam.mapping.mapper import NO_POINTS, Mapper
from slam.mapping.waiting_keyframes import (
    KNOWN_PLACE_FACTOR,
    SOLVE_DISTANCE,
    SOLVE_TURN,
    WaitingKeyframe,
    WaitingKeyframes,
)


@pytest.fixture(scope="module")
def slam() -> Slam:
    """A run in which keyframes wait."""
    slam, longest, farthest = Slam(), 0, 0.0
    for message in drivers.open("sim:office?duration=12&seed=3"):
        slam.add(message)
        waiting, distance = _waiting(slam.slam_state.mapper)
        longest, farthest = max(longest, waiting), max(farthest, distance)
        if waiting == 2 and slam.slam_state.mapper.keyframe_count > 20:
            break
    assert longest > 1
    assert 0.0 < farthest < KNOWN_PLACE_FACTOR * SOLVE_DISTANCE
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


OLD_WALL, NEW_WALL = 0, 1
FIRST_SEEN = np.array([0, 1])
"""The old wall was seen by keyframe 0, with which the graph was solved; the new one only later."""


def _has_moved_on(walls: list[int], half_lengths: list[float], distance: float = 0.0, turn: float = 0.0) -> bool:
    """Return if the graph has to be solved after keyframe 0 and two others that saw segments of some walls.

    The last one is `distance` metres, or `turn` radians, from keyframe 0.
    """
    count = len(walls)
    segments = Segments(np.zeros((count, 3)), np.array(half_lengths), np.zeros((count, 2, 2)))
    ids = LandmarkIds(np.array(walls, dtype=np.int64), np.zeros(0, dtype=np.int64))
    waiting = WaitingKeyframes([WaitingKeyframe(segments, ids, NO_POINTS)] * 2)
    poses = np.array([0.0, 0.5, 1.0])[:, None] * np.array([distance, 0.0, turn])
    return waiting.has_moved_on(poses, poses[:, 0].tolist(), FIRST_SEEN)


@pytest.mark.parametrize(
    ("walls", "half_lengths", "factor"),
    [
        ([OLD_WALL], [2.0], KNOWN_PLACE_FACTOR),
        ([OLD_WALL, NEW_WALL], [2.0, 0.2], KNOWN_PLACE_FACTOR),
        ([OLD_WALL, NEW_WALL], [2.0, 1.0], 1.0),
        ([OLD_WALL, -1], [2.0, 1.0], 1.0),  # a segment that belongs to no wall
        ([], [], 1.0),
    ],
)
def test_the_graph_is_solved_later_where_mainly_old_walls_are_seen(
    walls: list[int], half_lengths: list[float], factor: float
) -> None:
    for share, expected in ((0.95, False), (1.05, True)):
        assert _has_moved_on(walls, half_lengths, distance=share * factor * SOLVE_DISTANCE) is expected
        assert _has_moved_on(walls, half_lengths, turn=share * factor * SOLVE_TURN) is expected

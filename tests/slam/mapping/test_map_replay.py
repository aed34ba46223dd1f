"""Replay of a drive: the yielded map grows with the keyframes and ends as the finished map."""

import numpy as np

from slam.geometry.segments import CornerPoints, Segments
from slam.mapping.keyframes import KeyframeMotion, LandmarkIds
from slam.mapping.map_replay import replay
from slam.mapping.mapper import Mapper
from slam.mapping.repeated_observation import drop_unobserved, reset_observations

NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=int), np.zeros((0, 2)))
SIDES = np.array([[0.0, -2.0, 0.0], [3.0, 0.0, np.pi / 2], [0.0, 2.0, np.pi]])
OBSERVED = ([0], [0, 1], [1, 2], [0, 2])  # walls of each keyframe


def segments_of(walls: list[int]) -> Segments:
    """Return the segments of some walls as observed from the origin."""
    covariance = np.tile(1e-4 * np.eye(2), (len(walls), 1, 1))
    return Segments(SIDES[walls], np.ones(len(walls)), covariance)


def test_each_keyframe_adds_its_observations() -> None:
    mapper = Mapper()
    for side in SIDES:
        mapper.landmarks.add_wall(side, 1.0, 0)
    reset_observations(mapper.landmarks)
    for keyframe, walls in enumerate(OBSERVED):
        for wall in walls:
            mapper.landmarks.observe_wall(wall, SIDES[wall], 1.0, keyframe)
        motion = KeyframeMotion(keyframe - 1, np.array([0.1, 0.0, 0.0]), 1e-4 * np.eye(3)) if keyframe else None
        ids = LandmarkIds(np.array(walls), np.zeros(0, dtype=int))
        mapper.add_keyframe_with_ids(np.array([0.1 * keyframe, 0.0, 0.0]), motion, segments_of(walls), NO_CORNERS, ids)
    drop_unobserved(mapper.landmarks)
    mapper.solve()
    before = mapper.landmarks.walls.rows.copy()
    steps = []
    for past in replay(mapper, (segments_of(walls) for walls in OBSERVED)):
        rows = past.landmarks.walls.rows
        steps.append((past.keyframe_count, rows["observations"].tolist(), rows["in_graph"].tolist()))
        np.testing.assert_array_equal(past.pose, mapper.keyframe_poses[past.keyframe_count - 1])
    assert steps == [
        (1, [1, 0, 0], [False, False, False]),
        (2, [2, 1, 0], [True, False, False]),
        (3, [2, 2, 1], [True, True, False]),
        (4, [3, 2, 2], [True, True, True]),
    ]
    np.testing.assert_array_equal(mapper.landmarks.walls.rows, before)
    for column in ("first_seen", "last_seen", "observations", "frame", "low", "high"):
        np.testing.assert_array_equal(rows[column], before[column])

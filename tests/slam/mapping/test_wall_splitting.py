"""Walls whose stretches, on either side of an unseen gap, are two surfaces."""

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import CornerPoints, Segments
from slam.graph.final_solution import solve_with_range_bias
from slam.mapping.convergence import split_walls
from slam.mapping.keyframes import KeyframeMotion, LandmarkIds
from slam.mapping.mapper import Mapper
from slam.mapping.repeated_observation import drop_unobserved, reset_observations

SIGMAS = np.array([0.004, 0.004])
"""Of offset and heading of a segment: metres, radians."""
STRETCHES = np.array([[1.0, 2.0, np.pi], [5.0, 2.0, np.pi]])
"""Frames of the two stretches, 2 m long each, with 2 m between them that nobody saw."""


def map_with_gap(second: np.ndarray, seed: int, sigmas: np.ndarray = SIGMAS, unseen: int = 6) -> Mapper:
    """Return a solved map of 18 keyframes with one landmark for two stretches, and another wall.

    unseen  number of keyframes that do not see the second stretch, before the others
    """
    random = np.random.default_rng(seed)
    walls = np.array([STRETCHES[0], second, [-2.0, 0.0, -np.pi / 2]])
    mapper, pose = Mapper(), np.zeros(3)
    mapper.landmarks.add_wall(walls[0], 1.0, 0)
    mapper.landmarks.add_wall(walls[2], 1.0, 0)
    reset_observations(mapper.landmarks)
    for keyframe in range(18):
        truth = np.array([0.3 * keyframe, 0.0, 0.0])
        seen = [0, 2] if keyframe < unseen else [0, 1, 2]
        noise = np.column_stack([np.zeros(len(seen)), random.normal(0, sigmas, (len(seen), 2))])
        frames = se2.compose(se2.between(truth, walls[seen]), noise)
        segments = Segments(frames, np.ones(len(seen)), np.tile(np.diag(sigmas**2), (len(seen), 1, 1)))
        ids = np.array([{0: 0, 1: 0, 2: 1}[wall] for wall in seen])
        for wall, frame in zip(ids, walls[seen], strict=True):
            mapper.landmarks.observe_wall(int(wall), frame, 1.0, keyframe)
        step = np.array([0.3, 0.0, 0.0]) + random.normal(0, [0.01, 0.01, 0.005])
        motion = KeyframeMotion(keyframe - 1, step, np.diag([0.01, 0.01, 0.005]) ** 2) if keyframe else None
        pose = se2.compose(pose, step) if keyframe else pose
        no_corners = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=int), np.zeros((0, 2)))
        mapper.add_keyframe_with_ids(pose, motion, segments, no_corners, LandmarkIds(ids, np.zeros(0, dtype=int)))
    drop_unobserved(mapper.landmarks)
    mapper.solve()
    solve_with_range_bias(mapper.graph)
    return mapper


@pytest.mark.parametrize(("offset", "turn"), [(0.05, 0.0), (-0.03, 0.0), (0.0, 0.04)])
def test_stretches_that_are_two_surfaces_become_two_walls(offset: float, turn: float) -> None:
    second = se2.compose(STRETCHES[1], [0.0, offset, turn])
    mapper = map_with_gap(second, seed=1)
    before = mapper.keyframe_poses.copy()
    assert split_walls(mapper) == 1
    walls = mapper.landmarks.walls.rows
    assert walls["observations"].tolist() == [18, 18, 12]
    assert [ids.walls.tolist() for ids in mapper.landmark_ids[5:7]] == [[0, 1], [0, 2, 1]]
    relative = se2.between(walls["frame"][0], walls["frame"][2])
    expected = se2.between(STRETCHES[0], second)
    across = relative[1] - np.tan(relative[2]) * (relative[0] - expected[0])
    assert across == pytest.approx(expected[1], abs=0.012)
    assert relative[2] == pytest.approx(expected[2], abs=0.006)
    assert walls["high"][2] - walls["low"][2] == pytest.approx(2.0, abs=0.25)
    assert np.abs(mapper.keyframe_poses - before).max() < 0.2
    assert split_walls(mapper) == 0


def test_a_surface_that_one_keyframe_saw_becomes_a_wall() -> None:
    """Otherwise its extent would remain with the other surface, which is 5 cm off the line there."""
    mapper = map_with_gap(se2.compose(STRETCHES[1], [0.0, 0.05, 0.0]), seed=1, unseen=17)
    assert split_walls(mapper) == 1
    walls = mapper.landmarks.walls.rows
    assert walls["observations"].tolist() == [18, 18, 1]
    assert walls["high"][0] - walls["low"][0] == pytest.approx(2.0, abs=0.25)


@pytest.mark.slow
def test_one_wall_is_rarely_split_by_noise() -> None:
    splits = sum(split_walls(map_with_gap(STRETCHES[1], seed)) for seed in range(40))
    assert splits <= 1


@pytest.mark.slow
def test_surfaces_of_uncertain_heading_are_told_apart_by_evidence() -> None:
    """A step of 3 cm is some 3.3 standard deviations then, which are compatible with one line by chance."""
    sigmas, second = np.array([0.004, 0.012]), se2.compose(STRETCHES[1], [0.0, 0.03, 0.0])
    assert sum(split_walls(map_with_gap(second, seed, sigmas)) for seed in range(30)) >= 18
    assert sum(split_walls(map_with_gap(STRETCHES[1], seed, sigmas)) for seed in range(30)) <= 1

"""What is known of walls and corners: extents, identities, walls mapped twice, and how even walls are."""

import numpy as np
import pytest

from slam.mapping.landmarks import Landmarks
from slam.mapping.local_map import LocalMap, empty_local_map, local_map_around
from slam.mapping.wall_merging import Duplicate, find_duplicate_wall
from slam.mapping.wall_roughness import WallRoughness, add_roughness

STILL = [np.zeros((3, 3))]


def test_a_wall_grows_with_what_is_seen_of_it() -> None:
    landmarks = Landmarks()
    wall = landmarks.add_wall(np.array([1.0, 2.0, np.pi / 2]), 0.5, keyframe=0)
    landmarks.observe_wall(wall, np.array([1.0, 3.0, np.pi / 2]), 0.7, keyframe=1)
    landmarks.observe_wall(wall, np.array([1.0, 1.9, np.pi / 2]), 0.1, keyframe=1)
    row = landmarks.walls.rows[wall]
    assert (row["low"], row["high"]) == pytest.approx((-0.5, 1.7))
    assert (row["observations"], row["first_seen"], row["last_seen"]) == (2, 0, 1)  # keyframes count, not pieces


def test_an_absorbed_wall_leaves_its_extent_and_its_name() -> None:
    landmarks = Landmarks()
    first = landmarks.add_wall(np.array([0.0, 0.0, 0.0]), 1.0, keyframe=3)
    second = landmarks.add_wall(np.array([4.0, 0.01, 0.0]), 1.5, keyframe=1)
    third = landmarks.add_wall(np.array([-3.0, 0.01, 0.0]), 0.5, keyframe=9)
    landmarks.merge_walls(second, third)
    landmarks.merge_walls(first, second)
    walls = landmarks.walls.rows
    np.testing.assert_array_equal(walls["merged_into"], [first, first, first])
    assert (walls["low"][first], walls["high"][first]) == pytest.approx((-3.5, 5.5))
    assert (walls["observations"][first], walls["first_seen"][first], walls["last_seen"][first]) == (3, 1, 9)
    assert list(landmarks.walls_near(np.array([0.0, 1.0, 0.0]), 5.0)) == [first]


def test_between_its_ends_a_wall_may_have_doors() -> None:
    landmarks = Landmarks()
    wall = landmarks.add_wall(np.array([0.0, 0.0, 0.0]), 1.0, keyframe=0)
    landmarks.observe_wall(wall, np.array([4.0, 0.0, 0.0]), 1.0, keyframe=1)
    assert landmarks.is_covered(wall, 0.0)
    assert not landmarks.is_covered(wall, 2.0)
    assert landmarks.is_covered(wall, 4.0)


def test_walls_are_near_where_they_can_be_seen_from() -> None:
    landmarks = Landmarks()
    for frame in ([0.0, 0.0, 0.0], [0.0, 0.0, np.pi], [9.0, 0.0, 0.0]):
        landmarks.add_wall(np.array(frame), 1.0, keyframe=0)
    assert list(landmarks.walls_near(np.array([0.0, 2.0, 0.0]), 3.0)) == [0]
    assert list(landmarks.walls_near(np.array([0.0, -2.0, 0.0]), 3.0)) == [1]
    assert list(landmarks.walls_near(np.array([0.0, 2.0, 0.0]), 9.0)) == [0, 2]


def test_more_landmarks_than_room_was_made_for_keep_their_values() -> None:
    landmarks = Landmarks()
    for k in range(600):
        landmarks.add_corner(np.array([k, 0.0]), np.zeros(2), np.array([-1, -1]), keyframe=k)
    np.testing.assert_array_equal(landmarks.corners.rows["position"][:, 0], np.arange(600))
    assert list(landmarks.corners_near(np.array([300.0, 0.0, 0.0]), 1.5)) == [299, 300, 301]


def test_what_was_not_seen_for_long_is_less_certain() -> None:
    landmarks = Landmarks()
    for keyframe in (0, 2):
        landmarks.add_wall(np.array([0.0, -3.0, 0.0]), 1.0, keyframe)
    landmarks.walls.rows["covariance"][:] = 1e-6 * np.eye(2)
    grown = [np.zeros((3, 3)), np.zeros((3, 3)), np.diag([0.1, 0.2, 0.01]) ** 2]
    local_map = local_map_around(landmarks, np.zeros(3), 9.0, grown)
    sigma = np.sqrt(np.diagonal(local_map.wall_covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(sigma, [[0.2, 0.01], [0.001, 0.001]], rtol=0.02)
    assert len(empty_local_map().walls) == 0


def pair(second: tuple[float, float, float], sigma: float = 0.003, half: float = 1.0) -> LocalMap:
    """A wall along x and another one."""
    landmarks = Landmarks()
    landmarks.add_wall(np.array([0.0, 0.0, 0.0]), 1.0, keyframe=0)
    landmarks.add_wall(np.array(second), half, keyframe=0)
    landmarks.walls.rows["covariance"][:] = sigma**2 * np.eye(2)
    return local_map_around(landmarks, np.zeros(3), 50.0, STILL)


def duplicate(local_map: LocalMap, mature: bool = True, seen: bool = True) -> Duplicate | None:
    return find_duplicate_wall(local_map, np.array([True, mature]), np.array([False, seen]), 1e-6)


def test_two_frames_on_one_wall_are_found() -> None:
    found = duplicate(pair((1.2, 0.004, -0.003)))
    assert found is not None
    assert (found.first, found.second) == (0, 1)
    assert found.along == pytest.approx(1.2)
    assert found.distance < 5.0


@pytest.mark.parametrize(
    "other",
    [
        (1.2, 0.03, 0.0),  # ten standard deviations beside it
        (1.2, 0.0, 0.04),  # turned
        (2.5, 0.0, 0.0),  # beyond its end
        (0.0, 0.0, np.pi),  # the other face
        (0.0, 0.0, np.pi / 2),  # across
    ],
)
def test_what_is_another_wall_is_not(other: tuple[float, float, float]) -> None:
    assert duplicate(pair(other)) is None


def test_uncertain_walls_are_not_one_however_uncertain() -> None:
    assert duplicate(pair((1.2, 0.08, 0.0), sigma=0.1)) is not None
    assert duplicate(pair((1.2, 0.15, 0.0), sigma=0.1)) is None


def test_only_mature_walls_of_which_one_was_just_seen_are_compared() -> None:
    same = pair((1.2, 0.0, 0.0))
    assert duplicate(same, mature=False) is None
    assert duplicate(same, seen=False) is None


def scattered(unevenness: float, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals of segments on walls of this unevenness, their own covariances and half lengths."""
    random = np.random.default_rng(seed)
    sigma = random.uniform(0.001, 0.003, (count, 2))
    halves = random.uniform(0.3, 2.0, count)
    covariances = sigma[:, :, None] ** 2 * np.eye(2)
    whole = add_roughness(covariances, halves, unevenness**2)
    residuals = np.sqrt(np.diagonal(whole, axis1=1, axis2=2)) * random.normal(size=(count, 2))
    return residuals, covariances, halves


@pytest.mark.parametrize("unevenness", [0.004, 0.01])
def test_unevenness_is_learned_in_spite_of_wrong_associations(unevenness: float) -> None:
    roughness = WallRoughness()
    for seed in range(40):
        residuals, covariances, halves = scattered(unevenness, 12, seed)
        residuals[0] += 0.1
        roughness.add_residuals(residuals, covariances, halves)
    assert np.sqrt(roughness.variance) == pytest.approx(unevenness, rel=0.25)


def test_perfect_walls_are_found_to_be_even() -> None:
    roughness = WallRoughness()
    assert roughness.variance > 0.0
    for seed in range(60):
        roughness.add_residuals(*scattered(0.0, 12, seed))
    assert np.sqrt(roughness.variance) < 5e-4


def test_unevenness_turns_short_segments_more() -> None:
    result = add_roughness(np.zeros((2, 2, 2)), np.array([0.5, 1.0]), 1e-6)
    np.testing.assert_allclose(result[:, 0, 0], 1e-6)
    np.testing.assert_allclose(result[:, 1, 1], [1.2e-5, 3e-6])  # 12 f / length squared


def test_a_wall_is_told_in_pieces_where_a_door_divides_it():
    landmarks = Landmarks()
    wall = landmarks.add_wall(np.zeros(3), 1.0, keyframe=0)
    landmarks.observe_wall(wall, np.array([1.2, 0.0, 0.0]), 0.4, keyframe=1)  # the stretch goes on
    np.testing.assert_allclose(landmarks.pieces(wall), [[-1.0, 1.6]])
    landmarks.observe_wall(wall, np.array([3.5, 0.0, 0.0]), 1.0, keyframe=2)  # behind a door
    np.testing.assert_allclose(landmarks.pieces(wall), [[-1.0, 1.6], [2.5, 4.5]])
    other = landmarks.add_wall(np.array([2.0, 0.0, 0.0]), 0.5, keyframe=3)
    landmarks.merge_walls(wall, other)
    np.testing.assert_allclose(landmarks.pieces(wall), [[-1.0, 4.5]])

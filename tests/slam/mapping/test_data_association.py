"""Data association: which landmark a feature belongs to, and when it is new or ambiguous."""

import numpy as np
import pytest

from drivers import se2
from slam.geometry.roughness import Roughness
from slam.geometry.segments import CornerPoints, Segments
from slam.mapping.data_association import AMBIGUOUS, UNMATCHED, RowAssociation, associate
from slam.mapping.landmarks import Landmarks
from slam.mapping.local_map import LocalMap, empty_local_map, local_map_around

POSE = np.array([1.0, 0.5, 0.3])
CERTAIN = np.diag([0.002, 0.002, 0.001]) ** 2
NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))
NO_SEGMENTS = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
HALF = 0.5
ROUGHNESS = Roughness(1e-6, 1e-6)


def local_map_of(*walls: tuple[float, float, float], half: float = 2.0, observations: tuple[int, ...] = ()) -> LocalMap:
    landmarks = Landmarks()
    for wall in walls:
        landmarks.add_wall(np.array(wall), half, 0)
    landmarks.walls.rows["covariance"][:] = np.diag([0.002, 0.001]) ** 2
    for wall, count in enumerate(observations):
        landmarks.walls.rows["observations"][wall] = count
    return local_map_around(landmarks, np.zeros(3), 50.0, np.zeros((1, 3, 3)))


def seen(*frames: tuple[float, float, float], sigma: float = 0.003) -> Segments:
    """Return segments with frames given in the map, as observed from POSE."""
    count = len(frames)
    covariance = np.tile(np.diag([sigma**2, sigma**2]), (count, 1, 1))
    return Segments(se2.between(POSE, np.array(frames)).reshape(-1, 3), np.full(count, HALF), covariance)


def match(segments: Segments, local_map: LocalMap, covariance: np.ndarray = CERTAIN) -> RowAssociation:
    return associate(POSE, covariance, segments, NO_CORNERS, local_map, ROUGHNESS)


def test_each_segment_is_matched_to_its_own_wall() -> None:
    walls = [(2.0, -2.0, 0.0), (5.0, 0.0, 1.57), (2.0, 3.0, 3.14), (2.0, 3.5, 3.14)]
    found = match(seen(*(walls[k] for k in (3, 1, 0, 2))), local_map_of(*walls))
    np.testing.assert_array_equal(found.walls, [3, 1, 0, 2])
    assert (found.wall_distance < 1e-6).all()


def test_overlapping_segments_are_not_matched_to_the_same_wall() -> None:
    found = match(seen((2.0, -2.0, 0.0), (2.1, -2.004, 0.001)), local_map_of((2.0, -2.0, 0.0)))
    np.testing.assert_array_equal(found.walls, [0, AMBIGUOUS])


def test_separate_segments_are_matched_to_the_same_wall() -> None:
    found = match(seen((0.6, -2.0, 0.0), (2.0, -2.003, 0.001), (3.4, -2.002, -0.001)), local_map_of((2.0, -2.0, 0.0)))
    np.testing.assert_array_equal(found.walls, [0, 0, 0])


def test_a_segment_continues_a_wall_across_a_small_gap_only() -> None:
    local_map = local_map_of((2.0, -2.0, 0.0), half=1.0)
    assert match(seen((4.2, -2.0, 0.0)), local_map).walls[0] == 0
    assert match(seen((4.8, -2.0, 0.0)), local_map).walls[0] == UNMATCHED


def test_the_two_faces_of_a_thin_wall_are_different_walls() -> None:
    found = match(seen((2.0, -2.0, np.pi)), local_map_of((2.0, -2.0, 0.0)))
    assert found.walls[0] == UNMATCHED
    assert np.isnan(found.wall_distance[0])


@pytest.mark.parametrize(
    ("offset", "turn", "expected"),
    [(0.004, 0.0, 0), (0.08, 0.0, AMBIGUOUS), (0.0, 0.08, AMBIGUOUS), (0.2, 0.0, UNMATCHED), (0.0, 0.2, UNMATCHED)],
)
def test_segments_just_outside_the_gate_are_ambiguous_and_others_new(offset: float, turn: float, expected: int) -> None:
    found = match(seen((2.0, -2.0 + offset, turn)), local_map_of((2.0, -2.0, 0.0)))
    assert found.walls[0] == expected


def test_the_gate_widens_with_the_uncertainty_of_the_pose() -> None:
    segments, local_map = seen((2.0, -1.92, 0.02)), local_map_of((2.0, -2.0, 0.0))
    assert match(segments, local_map).walls[0] == AMBIGUOUS
    uncertain = np.diag([0.05, 0.05, 0.02]) ** 2
    assert match(segments, local_map, uncertain).walls[0] == 0
    far = seen((2.0, -1.65, 0.0))
    assert match(far, local_map, 100 * uncertain).walls[0] == UNMATCHED  # beyond the largest offset


def test_of_two_close_walls_the_one_with_more_observations_is_preferred() -> None:
    walls = ((2.0, -2.0, 0.008), (2.0, -2.0, -0.004))
    between = seen((2.0, -2.0, 0.005))
    assert match(between, local_map_of(*walls, observations=(5, 5))).walls[0] == 0
    assert match(between, local_map_of(*walls, observations=(2, 40))).walls[0] == 1


def test_distances_are_squared_mahalanobis_distances() -> None:
    found = match(
        seen((2.0, -1.99, 0.0), sigma=0.01), local_map_of((2.0, -2.0, 0.0)), np.zeros((3, 3)) + 1e-12 * np.eye(3)
    )
    # variances of segment, wall and roughness
    expected = 0.01**2 / (0.01**2 + 0.002**2 + 1e-6)
    assert found.wall_distance[0] == pytest.approx(expected, rel=1e-3)


def corners_seen(*corners: tuple[tuple[float, float], tuple[float, float]]) -> CornerPoints:
    position = np.array([corner[0] for corner in corners]).reshape(-1, 2)
    headings = np.array([corner[1] for corner in corners]).reshape(-1, 2)
    count = len(corners)
    return CornerPoints(
        se2.transform(se2.inverse(POSE), position).reshape(-1, 2),
        np.tile(1e-5 * np.eye(2), (count, 1, 1)),
        np.zeros((count, 2), int),
        headings - POSE[2],
    )


def test_corners_are_matched_by_position_and_headings() -> None:
    landmarks = Landmarks()
    for position in ([4.0, 0.0], [4.0, 3.0]):
        landmarks.add_corner(np.array(position), np.array([0.0, 1.57]), np.array([-1, -1]), 0)
    landmarks.corners.rows["covariance"][:] = 1e-5 * np.eye(2)
    local_map = local_map_around(landmarks, np.zeros(3), 50.0, np.zeros((1, 3, 3)))
    corners = corners_seen(
        ((4.0, 3.005), (0.0, 1.57)),  # the second
        ((4.0, 0.0), (1.57, 3.14)),  # at the first, but of other walls
        ((4.06, 0.06), (0.0, 1.57)),  # beside the first
        ((8.0, 0.0), (0.0, 1.57)),  # elsewhere
    )
    found = associate(POSE, CERTAIN, NO_SEGMENTS, corners, local_map, ROUGHNESS)
    np.testing.assert_array_equal(found.corners, [1, UNMATCHED, AMBIGUOUS, UNMATCHED])
    np.testing.assert_array_equal(np.isnan(found.corner_distance), [False, True, False, True])


def test_a_corner_is_matched_once() -> None:
    landmarks = Landmarks()
    landmarks.add_corner(np.array([4.0, 0.0]), np.array([0.0, 1.57]), np.array([-1, -1]), 0)
    landmarks.corners.rows["covariance"][:] = 1e-5 * np.eye(2)
    local_map = local_map_around(landmarks, np.zeros(3), 50.0, np.zeros((1, 3, 3)))
    twice = corners_seen(((4.004, 0.0), (0.0, 1.57)), ((4.0, 0.0), (0.0, 1.57)))
    found = associate(POSE, CERTAIN, NO_SEGMENTS, twice, local_map, ROUGHNESS)
    np.testing.assert_array_equal(found.corners, [AMBIGUOUS, 0])


def test_empty_scans_and_maps() -> None:
    assert len(associate(POSE, CERTAIN, NO_SEGMENTS, NO_CORNERS, local_map_of((0.0, 1.0, 0.0)), ROUGHNESS).walls) == 0
    found = associate(
        POSE, CERTAIN, seen((2.0, -2.0, 0.0)), corners_seen(((1.0, 1.0), (0.0, 1.0))), empty_local_map(), ROUGHNESS
    )
    np.testing.assert_array_equal(found.walls, [UNMATCHED])
    np.testing.assert_array_equal(found.corners, [UNMATCHED])

"""Landmarks: extents, ids, merging, the local map, and observing all landmarks again."""

from typing import Any

import numpy as np
import pytest

from drivers import se2
from slam.mapping.landmark_table import UNOBSERVED
from slam.mapping.landmarks import Landmarks
from slam.mapping.local_map import _wall_drifts, empty_local_map, local_map_around
from slam.mapping.near_landmarks import BEHIND_MARGIN, near_corners, near_walls
from slam.mapping.repeated_observation import drop_unobserved, reset_observations
from slam.mapping.sight_lines import walls_in_view
from slam.mapping.wall_cells import MIN_GAP_BETWEEN_PIECES, cells_between


def test_observations_extend_a_wall() -> None:
    landmarks = Landmarks()
    wall = landmarks.add_wall(np.array([1.0, 2.0, np.pi / 2]), 0.5, keyframe=0)
    landmarks.observe_wall(wall, np.array([1.0, 3.0, np.pi / 2]), 0.7, keyframe=1)
    landmarks.observe_wall(wall, np.array([1.0, 1.9, np.pi / 2]), 0.1, keyframe=1)
    row = landmarks.walls.rows[wall]
    assert (row["low"], row["high"]) == pytest.approx((-0.5, 1.7))
    assert (row["observations"], row["first_seen"], row["last_seen"]) == (2, 0, 1)  # keyframes, not segments


def test_a_merged_wall_adds_its_extent_and_observations() -> None:
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


def test_unobserved_parts_of_a_wall_are_not_covered() -> None:
    landmarks = Landmarks()
    wall = landmarks.add_wall(np.array([0.0, 0.0, 0.0]), 1.0, keyframe=0)
    landmarks.observe_wall(wall, np.array([4.0, 0.0, 0.0]), 1.0, keyframe=1)
    assert landmarks.is_covered(wall, 0.0)
    assert not landmarks.is_covered(wall, 2.0)
    assert landmarks.is_covered(wall, 4.0)


def test_walls_are_near_on_their_visible_side_only() -> None:
    landmarks = Landmarks()
    for frame in ([0.0, 0.0, 0.0], [0.0, 0.0, np.pi], [9.0, 0.0, 0.0]):
        landmarks.add_wall(np.array(frame), 1.0, keyframe=0)
    assert list(landmarks.walls_near(np.array([0.0, 2.0, 0.0]), 3.0)) == [0]
    assert list(landmarks.walls_near(np.array([0.0, -2.0, 0.0]), 3.0)) == [1]
    assert list(landmarks.walls_near(np.array([0.0, 2.0, 0.0]), 9.0)) == [0, 2]


@pytest.mark.parametrize("radius", [0.5, 3.0, 12.0])
def test_walls_are_near_if_a_part_of_them_is(radius: float) -> None:
    random, landmarks = np.random.default_rng(3), Landmarks()
    for frame in random.uniform([-15.0, -15.0, -np.pi], [15.0, 15.0, np.pi], (300, 3)):
        wall = landmarks.add_wall(frame, random.uniform(0.2, 4.0), keyframe=0)
        landmarks.observe_wall(wall, se2.compose(frame, [random.uniform(-20.0, 20.0), 0.0, 0.0]), 0.5, keyframe=1)
    rows, pose = landmarks.walls.rows, np.array([2.0, 1.0, 0.3])
    along, ahead = se2.transform(se2.inverse(rows["frame"]), pose[:2]).T
    distances = np.hypot(along - along.clip(rows["low"], rows["high"]), ahead)
    expected = np.flatnonzero((distances < radius) & (ahead > -BEHIND_MARGIN))
    np.testing.assert_array_equal(landmarks.walls_near(pose, radius), expected)
    points = radius * np.array([[1.0, 0.0], [0.0, 1.0]])  # from either side a wall may be seen through
    in_view = walls_in_view(landmarks, pose, points).walls
    np.testing.assert_array_equal(in_view, np.flatnonzero(distances < radius))


def test_nothing_is_compiled_again_for_a_map_of_one_wall_or_corner() -> None:
    """Numpy calls a column of a table of one row contiguous, and that of several rows not."""
    landmarks = Landmarks()
    functions: list[Any] = [near_walls, near_corners, _wall_drifts]
    for k in range(3):
        local_map_around(landmarks, np.zeros(3), 5.0, np.zeros((3, 3, 3)))
        landmarks.add_wall(np.array([k, -1.0, 0.0]), 1.0, keyframe=0)
        local_map_around(landmarks, np.zeros(3), 5.0, np.zeros((3, 3, 3)))
        landmarks.add_corner(np.array([k, 0.0]), np.zeros(2), np.array([k, k]), keyframe=0)
    assert len(local_map_around(landmarks, np.zeros(3), 5.0, np.zeros((3, 3, 3))).walls) == 3
    assert [len(function.signatures) for function in functions] == [1, 1, 1]


def test_landmarks_keep_their_values_when_the_table_grows() -> None:
    landmarks = Landmarks()
    for k in range(600):
        landmarks.add_corner(np.array([k, 0.0]), np.zeros(2), np.array([-1, -1]), keyframe=k)
    np.testing.assert_array_equal(landmarks.corners.rows["position"][:, 0], np.arange(600))
    assert list(landmarks.corners_near(np.array([300.0, 0.0, 0.0]), 1.5)) == [299, 300, 301]


def test_landmarks_not_observed_recently_are_less_certain() -> None:
    landmarks = Landmarks()
    for keyframe in (0, 2):
        landmarks.add_wall(np.array([0.0, -3.0, 0.0]), 1.0, keyframe)
    landmarks.set_wall_covariances(np.arange(2), 1e-6 * np.eye(2))
    grown = [np.zeros((3, 3)), np.zeros((3, 3)), np.diag([0.05, 0.08, 0.01]) ** 2]
    local_map = local_map_around(landmarks, np.zeros(3), 9.0, np.array(grown))
    sigma = np.sqrt(np.diagonal(local_map.wall_covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(sigma, [[0.08, 0.01], [0.001, 0.001]], rtol=0.02)
    assert len(empty_local_map().walls) == 0


def test_corners_are_as_uncertain_as_the_drift_since_they_were_observed() -> None:
    landmarks, grown = Landmarks(), np.array([0.01, 0.04, 0.1, 0.2])[:, None, None] * np.diag([0.05, 0.03, 0.001])
    for keyframe in (3, 1, 2, 0, 1):
        landmarks.add_wall(np.array([0.0, -3.0, 0.0]), 1.0, keyframe)
        landmarks.add_corner(np.array([keyframe, 1.0]), np.zeros(2), np.array([-1, -1]), keyframe)
    local_map = local_map_around(landmarks, np.zeros(3), 9.0, grown)
    np.testing.assert_array_equal(local_map.corners, [0, 1, 2, 3, 4])
    drift = (grown[-1] - grown)[[3, 1, 2, 0, 1], :2, :2]
    np.testing.assert_allclose(local_map.corner_covariance, drift, atol=1e-12)


def test_landmarks_whose_place_is_not_known_are_left_out_of_the_local_map() -> None:
    """Three standard deviations exceed the limits of association, so the right wall may lie outside them."""
    landmarks = Landmarks()
    for keyframe in (0, 2):
        landmarks.add_wall(np.array([0.0, -3.0, 0.0]), 1.0, keyframe)
    for sigmas in ([0.0, 0.11, 0.0], [0.0, 0.0, np.radians(2.7)]):
        grown = [np.zeros((3, 3)), np.zeros((3, 3)), np.diag(sigmas) ** 2]
        np.testing.assert_array_equal(local_map_around(landmarks, np.zeros(3), 9.0, np.array(grown)).walls, [1])


def test_landmarks_that_only_keyframes_without_a_link_have_seen_are_left_out_of_the_local_map() -> None:
    landmarks, frame = Landmarks(), np.array([0.0, -3.0, 0.0])
    for keyframe in (0, 2, 9):
        landmarks.add_wall(frame, 1.0, keyframe)
        landmarks.add_corner(np.array([keyframe, 1.0]), np.zeros(2), np.array([-1, -1]), keyframe)
    landmarks.observe_wall(0, frame, 1.0, 5)  # of keyframes 0 to 5
    certain = np.zeros((10, 3, 3))
    for linked, walls, corners in (([7], [2], [2]), ([2, 4], [0, 1, 2], [1, 2]), ([], [2], [2])):
        local_map = local_map_around(landmarks, np.zeros(3), 20.0, certain, np.array(linked, dtype=np.int64))
        np.testing.assert_array_equal(local_map.walls, walls)
        np.testing.assert_array_equal(local_map.corners, corners)


def test_a_door_divides_a_wall_into_pieces() -> None:
    landmarks = Landmarks()
    wall = landmarks.add_wall(np.zeros(3), 1.0, keyframe=0)
    landmarks.observe_wall(wall, np.array([1.2, 0.0, 0.0]), 0.4, keyframe=1)  # continues the stretch
    np.testing.assert_allclose(landmarks.pieces(wall), [[-1.0, 1.6]])
    landmarks.observe_wall(wall, np.array([3.5, 0.0, 0.0]), 1.0, keyframe=2)  # behind a door
    np.testing.assert_allclose(landmarks.pieces(wall), [[-1.0, 1.6], [2.5, 4.5]])
    other = landmarks.add_wall(np.array([2.0, 0.0, 0.0]), 0.5, keyframe=3)
    landmarks.merge_walls(wall, other)
    np.testing.assert_allclose(landmarks.pieces(wall), [[-1.0, 4.5]])


def test_pieces_of_many_walls_are_those_of_each() -> None:
    landmarks = Landmarks()
    assert landmarks.pieces_of_walls(np.arange(0)) == []
    for wall, (covered, low, high) in enumerate(
        (([0, 1, 2, 9, 10], 0.0, 1.1), ([], -1.0, 1.0), ([-30, -29, 5], -4.0, 2.0), ([3], 0.3, 0.4))
    ):
        landmarks.add_wall(np.zeros(3), 1.0, keyframe=0)
        landmarks.covered[wall] = frozenset(covered)
        landmarks.walls.rows[["low", "high"]][wall] = low, high
    expected = ([[0.0, 0.3], [0.9, 1.1]], [[-1.0, 1.0]], [[-3.0, -2.8], [0.5, 0.6]], [[0.3, 0.4]])
    for wall, (pieces, together) in enumerate(zip(expected, landmarks.pieces_of_walls(np.arange(4)), strict=True)):
        np.testing.assert_allclose(together, pieces)
        np.testing.assert_array_equal(landmarks.pieces(wall), together)


def test_a_line_past_an_opening_does_not_close_it_without_points_in_it() -> None:
    """A scan along a wall shows it on both sides of a door as one line: no beam happens to pass through the door."""
    frame = np.array([4.0, 1.0, 2.5])
    door = range(-4, 5)
    beside = np.column_stack([[-2.1, -1.6, -1.2, -0.6, 0.7, 1.1, 1.6, 2.1], np.zeros(8)])
    through = np.column_stack([np.linspace(-0.35, 0.45, 9), np.full(9, 1.0)])
    for inside, closed in (([], False), (through, False), (through - [0.0, 1.02], True)):
        landmarks = Landmarks()
        wall = landmarks.add_wall(frame, 2.0, keyframe=0)
        landmarks.open_wall(wall, door, 5)
        points = np.concatenate([beside, np.reshape(inside, (-1, 2))])
        landmarks.observe_wall(wall, frame, 2.5, 9, se2.transform(frame, points))
        assert bool(landmarks.opened_cells(wall)) != closed
        assert len(landmarks.pieces(wall)) == (1 if closed else 2)
        assert landmarks.walls.rows["high"][wall] == 2.5


@pytest.mark.parametrize("points_known", [True, False])
def test_stretches_without_points_are_not_covered(points_known: bool) -> None:
    """At grazing incidence, a line passes a door without a beam in between."""
    frame, away = np.array([4.0, 1.0, 2.5]), np.array([1.0, 0.0, 0.0])
    left, right, behind = (np.linspace(*ends, 30) for ends in ((-2.0, -0.4), (0.5, 2.0), (-0.4, 0.5)))
    across = np.repeat([0.01, -0.01, -0.8], 30)  # the last ones are seen through the door
    points = np.column_stack([np.concatenate([left, right, behind]), across])
    landmarks = Landmarks()
    wall = landmarks.add_wall(frame, 2.0, 0, se2.transform(frame, points) if points_known else None)
    pieces = [[-2.0, -0.4], [0.5, 2.0]] if points_known else [[-2.0, 2.0]]
    np.testing.assert_allclose(landmarks.pieces(wall), pieces, atol=0.11)
    there = se2.compose(frame, away)
    landmarks.observe_wall(wall, there, 2.0, 1, se2.transform(there, points) if points_known else None)
    pieces = [[-2.0, 3.0]]  # the door of the second line is where the first one has points, and the reverse
    np.testing.assert_allclose(landmarks.pieces(wall), pieces, atol=0.11)


def test_a_gap_next_to_the_end_of_a_wall_is_left_out() -> None:
    """The farthest point of a line at grazing incidence may be behind a door."""
    landmarks, along = Landmarks(), np.append(np.linspace(-2.0, 1.0, 30), 2.0)
    wall = landmarks.add_wall(np.zeros(3), 2.0, 0, np.column_stack([along, np.zeros(31)]))
    np.testing.assert_allclose(landmarks.pieces(wall), [[-2.0, 1.0]], atol=0.11)


def test_a_point_alone_in_a_door_does_not_close_it() -> None:
    """It is nearer to both jambs than the width from which on a gap is a door."""
    beside = [np.linspace(-2.0, -0.45, 20), np.linspace(0.45, 2.0, 20)]
    landmarks = Landmarks()
    frame = np.zeros(3)
    wall = landmarks.add_wall(frame, 2.0, 0, np.column_stack([np.concatenate(beside), np.zeros(40)]))
    far = np.array([[-2.0, 0.0], [-1.5, 0.0], [0.05, 0.0], [1.5, 0.0], [2.0, 0.0]])  # a scan from afar, with few points
    landmarks.observe_wall(wall, frame, 2.0, 1, far)
    np.testing.assert_allclose(landmarks.pieces(wall), [[-2.0, -0.4], [0.4, 2.0]], atol=0.11)


def test_points_that_are_close_enough_cover_the_stretch_between_them() -> None:
    landmarks = Landmarks()
    along = np.arange(-2.0, 2.01, 0.9 * MIN_GAP_BETWEEN_PIECES)
    wall = landmarks.add_wall(np.zeros(3), 2.0, 0, np.column_stack([along, np.zeros(len(along))]))
    assert landmarks.covered[wall] == cells_between(-2.0, 2.0)


def test_an_opened_end_of_a_wall_is_not_drawn_again_by_a_line_without_points() -> None:
    landmarks = Landmarks()
    wall = landmarks.add_wall(np.zeros(3), 2.0, keyframe=0)
    landmarks.open_wall(wall, range(10, 20), 5)
    landmarks.observe_wall(wall, np.zeros(3), 2.0, 9, np.column_stack([np.linspace(-2.0, 0.9, 30), np.zeros(30)]))
    assert landmarks.walls.rows["high"][wall] < 1.2


def test_observing_again_keeps_ids_and_drops_unobserved_landmarks() -> None:
    landmarks = Landmarks()
    for y in (0.0, 1.0, 2.0):
        landmarks.add_wall(np.array([0.0, y, 0.0]), 1.0, keyframe=0)
        landmarks.add_corner(np.array([1.0, y]), np.zeros(2), np.array([-1, -1]), keyframe=0)
    landmarks.merge_walls(2, 1)
    landmarks.confirm_observed(1)
    reset_observations(landmarks)
    landmarks.observe_wall(0, np.array([0.5, 0.0, 0.0]), 0.4, keyframe=4)
    landmarks.observe_wall(0, np.array([0.5, 0.0, 0.0]), 0.4, keyframe=7)
    landmarks.observe_corner(0, np.zeros(2), keyframe=4)
    drop_unobserved(landmarks)
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    assert (walls["low"][0], walls["high"][0]) == pytest.approx((0.1, 0.9))
    assert (walls["observations"][0], walls["first_seen"][0], walls["last_seen"][0]) == (2, 4, 7)
    np.testing.assert_array_equal(walls["merged_into"], [0, UNOBSERVED, UNOBSERVED])
    np.testing.assert_array_equal(landmarks.active(), [True, False, False])
    assert not walls["in_graph"].any()
    np.testing.assert_array_equal(np.isnan(corners["position"]).any(axis=1), [False, True, True])
    assert list(landmarks.corners_near(np.zeros(3), 9.0)) == [0]

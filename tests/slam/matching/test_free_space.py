"""Points that appear in free space, such as those on a person who follows the robot."""

from __future__ import annotations

import copy

import numpy as np

from slam.geometry.segments import Floats
from slam.matching.distance_field import ALL_POINTS, DistanceField, nearest_distance
from slam.matching.free_space import NEW_SURFACE, SIGHTINGS
from slam.matching.offset_tiles import FIELD_CELL

ROBOT = np.zeros(3)
PERSON = np.column_stack([np.linspace(-0.1, 0.1, 5) + 2.0, np.full(5, 0.3)])  # metres
ANGLES = np.linspace(-np.pi, np.pi, 720, endpoint=False)
ROOM = 5.0 * np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])  # a round one around the robot


def distance(field: DistanceField, position: Floats) -> float:
    """Return the distance (metres) of a position (2,) from the nearest point of the field."""
    x, y = (position - field.origin) / FIELD_CELL
    return float(nearest_distance(field.arrays, ALL_POINTS, x, y))


def room() -> DistanceField:
    """Return the field of an empty round room."""
    field = DistanceField.empty(np.zeros(2), 10.0)
    field.insert(ROBOT, ROOM)
    return field


def line_across(x: float, from_y: float, to_y: float) -> Floats:
    """Return points (p, 4), with normals, on a line across the robot's way."""
    y = np.arange(from_y, to_y, 0.05)
    return np.column_stack([0 * y + x, y, 0 * y - 1.0, 0 * y])


def corridor(length: float) -> Floats:
    """Return points (p, 4), with normals, on the walls of a corridor 2 m wide that ends `length` metres ahead."""
    x = np.arange(-1.0, length, 0.05)
    sides = [np.column_stack([x, 0 * x + y, 0 * x, 0 * x - y]) for y in (-1.0, 1.0)]
    return np.concatenate([*sides, line_across(length, -1.0, 1.0)])


def test_a_point_in_free_space_waits_for_a_second_scan() -> None:
    field = room()
    field.insert(ROBOT, PERSON)
    assert distance(field, PERSON[2]) > NEW_SURFACE
    copy.deepcopy(field).insert(ROBOT, PERSON)
    assert distance(field, PERSON[2]) > NEW_SURFACE
    field.insert(ROBOT, PERSON)
    assert distance(field, PERSON[2]) < NEW_SURFACE


def test_a_line_in_free_space_waits_until_enough_scans_in_a_row_have_seen_it() -> None:
    field, line = room(), line_across(2.0, -1.0, 1.0)
    for _ in range(SIGHTINGS):
        field.insert(ROBOT, line)
        field.insert(ROBOT, ROOM)  # a scan that does not see it
    assert distance(field, line[5, :2]) > NEW_SURFACE
    for _ in range(SIGHTINGS):
        assert distance(field, line[5, :2]) > NEW_SURFACE
        field.insert(ROBOT, line)
    assert distance(field, line[5, :2]) < NEW_SURFACE


def test_a_person_who_keeps_ahead_of_the_robot_never_enters() -> None:
    field = room()
    for step in range(6):
        field.insert(np.array([0.4 * step, 0.0, 0.0]), PERSON)
    ahead = [distance(field, PERSON[2] + np.array([0.4 * step, 0.0])) for step in range(6)]
    assert min(ahead) > NEW_SURFACE


def test_a_surface_in_space_that_was_not_seen_enters_at_once() -> None:
    field = DistanceField.empty(np.zeros(2), 10.0)
    field.insert(ROBOT, ROOM[:90])
    field.insert(ROBOT, PERSON)
    assert distance(field, PERSON[2]) < NEW_SURFACE


def test_a_line_waits_as_a_whole_also_at_walls_and_where_nothing_was_seen_before() -> None:
    field = DistanceField.empty(np.zeros(2), 10.0)
    field.insert(ROBOT, corridor(6.0))
    field.insert(ROBOT, line_across(3.0, -0.95, 1.6))
    for y in (-0.7, 0.0, 0.7, 1.5):
        assert distance(field, np.array([3.0, y])) > NEW_SURFACE
    field.insert(ROBOT, line_across(7.5, -0.95, 1.6))  # in space that was not seen before
    assert distance(field, np.array([7.5, 0.0])) < NEW_SURFACE


def test_a_line_that_comes_nearer_and_recedes_never_enters() -> None:
    field = DistanceField.empty(np.zeros(2), 10.0)
    field.insert(ROBOT, corridor(9.0))
    places = [5.0, 4.4, 4.4, 5.0, 6.2]  # of a robot that drives 0.4 m from one scan to the next
    for scan, x in enumerate(places):
        driven = 0.4 * scan
        field.insert(np.array([driven, 0.0, 0.0]), line_across(x - driven, -0.95, 0.95))
    assert min(distance(field, np.array([x, 0.0])) for x in places) > NEW_SURFACE


def test_points_of_several_scans_at_once_enter_as_one_after_the_other() -> None:
    scans = [ROOM, PERSON, PERSON + np.array([0.3, 0.0]), PERSON, ROOM * 0.9]
    with_normals = [np.column_stack([scan, np.zeros_like(scan)]) for scan in scans]
    one_by_one, together = (DistanceField.empty(np.zeros(2), 10.0) for _ in range(2))
    for scan in with_normals:
        one_by_one.insert(ROBOT, scan)
    together.insert_scans(np.zeros((len(scans), 3)), with_normals)
    assert together.waiting.scans == one_by_one.waiting.scans == len(scans)
    np.testing.assert_array_equal(together.waiting.cells, one_by_one.waiting.cells)
    np.testing.assert_array_equal(together.seen, one_by_one.seen)
    count = one_by_one.offsets.count
    assert together.offsets.count == count
    np.testing.assert_array_equal(together.offsets.tiles[:count], one_by_one.offsets.tiles[:count])

"""Points that appear in free space, such as those on a person who follows the robot."""

from __future__ import annotations

import copy

import numpy as np

from slam.geometry.segments import Floats
from slam.matching.distance_field import ALL_POINTS, DistanceField, nearest_distance
from slam.matching.free_space import NEW_SURFACE
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


def test_a_point_in_free_space_waits_for_a_second_scan() -> None:
    field = room()
    field.insert(ROBOT, PERSON)
    assert distance(field, PERSON[2]) > NEW_SURFACE
    other = copy.deepcopy(field)
    field.insert(ROBOT, ROOM)
    assert distance(field, PERSON[2]) > NEW_SURFACE
    for seen_again in (field, other):
        seen_again.insert(ROBOT, PERSON)
        assert distance(seen_again, PERSON[2]) < NEW_SURFACE


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


def test_points_of_several_scans_at_once_enter_as_one_after_the_other() -> None:
    scans = [ROOM, PERSON, PERSON + np.array([0.3, 0.0]), PERSON, ROOM * 0.9]
    with_normals = [np.column_stack([scan, np.zeros_like(scan)]) for scan in scans]
    one_by_one, together = (DistanceField.empty(np.zeros(2), 10.0) for _ in range(2))
    for scan in with_normals:
        one_by_one.insert(ROBOT, scan)
    together.insert_scans(np.zeros((len(scans), 3)), with_normals)
    assert together.waiting.scans == one_by_one.waiting.scans == len(scans)
    np.testing.assert_array_equal(together.waiting.scan_of, one_by_one.waiting.scan_of)
    np.testing.assert_array_equal(together.seen, one_by_one.seen)
    count = one_by_one.offsets.count
    assert together.offsets.count == count
    np.testing.assert_array_equal(together.offsets.tiles[:count], one_by_one.offsets.tiles[:count])

"""Doors and passages are gaps that were driven through, or that both faces of a wall have."""

from __future__ import annotations

import numpy as np
import pytest

from slam.measuring.measured_map import measure_all
from slam.measuring.openings import Opening, find_openings
from slam.measuring.rooms import find_rooms

from .plans import Point, around, room, wall_map

BELOW = [[(0.0, 0.0), (2.0, 0.0), (3.0, 0.0), (5.0, 0.0)]]
"""A face with a gap of 1 m."""
BEHIND = [[(5.0, -0.2), (3.1, -0.2), (2.0, -0.2), (0.0, -0.2)]]
"""The other face of the same wall, with a gap of 1.1 m."""
THROUGH = [(2.5, -2.0), (2.5, 2.0)]
BESIDE = [(1.0, 1.0), (2.0, 1.5)]


def found(walls: list[list[Point]], path: list[Point]) -> list[Opening]:
    return find_openings(wall_map(walls, path=path), [])


def test_a_gap_that_was_driven_through_is_a_door() -> None:
    (door,) = found(BELOW, THROUGH)
    assert (door.name, door.walls, door.driven) == ("door 1", (10,), True)
    assert door.width == pytest.approx(1.0)
    np.testing.assert_allclose(door.ends, [[2.0, 0.0], [3.0, 0.0]], atol=1e-9)


def test_a_gap_in_both_faces_of_a_wall_is_one_door_in_the_middle() -> None:
    (door,) = found([*BELOW, *BEHIND], BESIDE)
    assert (door.name, door.walls, door.driven) == ("door 1", (10, 11), False)
    np.testing.assert_allclose(np.sort(door.ends, axis=0), [[2.0, -0.1], [3.1, -0.1]], atol=1e-9)
    assert len(found([*BELOW, *BEHIND], THROUGH)) == 1


@pytest.mark.parametrize(
    ("walls", "path"),
    [
        (BELOW, BESIDE),  # perhaps it was not seen: a cupboard
        ([*BELOW, [(5.0, -0.2), (3.5, -0.2), (2.0, -0.2), (0.0, -0.2)]], BESIDE),  # as above, on both sides
        ([*BELOW, [(2.5, 1.0), (2.5, -1.0)]], [(2.3, -2.0), (2.3, 2.0)]),  # a wall goes through it
        ([*BELOW, [(5.0, -2.0), (3.0, -2.0), (2.0, -2.0), (0.0, -2.0)]], BESIDE),  # faces of two walls
        ([*BELOW, [(1.9, 0.05), (3.1, 0.05)]], THROUGH),  # another landmark of the same face closes it
        ([[(0.0, 0.0), (2.0, 0.0), (8.0, 0.0), (9.0, 0.0)]], THROUGH),  # 6 m
        ([[(0.0, 0.0), (2.0, 0.0)], [(3.0, 0.6), (5.0, 0.6)]], THROUGH),  # not on one line
    ],
)
def test_no_opening_is_made_up(walls: list[list[Point]], path: list[Point]) -> None:
    assert not found(walls, path)


def test_a_gap_between_two_walls_on_one_line_is_an_opening_and_a_wide_one_is_a_passage() -> None:
    (passage,) = found([[(0.0, 0.0), (2.0, 0.0)], [(4.5, 0.03), (6.0, 0.03)]], THROUGH)
    assert (passage.name, passage.walls) == ("passage 1", (10, 11))
    assert passage.width == pytest.approx(2.5, abs=0.01)


def test_a_door_in_two_landmarks_of_one_face_is_one_door() -> None:
    (door,) = found([*BELOW, [(0.5, 0.02), (1.9, 0.02)]], THROUGH)
    assert door.walls == (10, 11)
    assert not found([*BELOW, [(0.5, 0.02), (1.9, 0.02)]], BESIDE)


def test_a_door_leads_into_the_rooms_on_both_sides() -> None:
    lower = [(0.0, -4.2), (5.0, -4.2), (5.0, -0.2), (0.0, -0.2)]
    walls = [*room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]), *room(lower)]
    walls[0], walls[6] = BELOW[0], BEHIND[0]
    measured = measure_all(wall_map(walls, [*around(4), *around(4, 4)], path=[(2.5, -3.0), (2.5, 2.0)]))
    assert len(measured.rooms) == 2
    (door,) = measured.openings
    assert door.rooms == (1, 2)


def test_the_label_of_a_room_is_in_it_and_not_in_its_island() -> None:
    core = [(1.5, 1.5), (1.5, 4.5), (8.5, 4.5), (8.5, 1.5)]
    walls = [*room([(0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (0.0, 6.0)]), *room(core)]
    (corridor,) = find_rooms(wall_map(walls, [*around(4), *around(4, 4)], path=[(1.0, 1.0), (9.0, 1.0)]))
    x, y = corridor.label_place
    assert 1.5 < x < 8.5  # where there is space for text
    assert min(abs(y - 0.75), abs(y - 5.25)) < 0.2

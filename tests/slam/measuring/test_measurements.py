"""Measurements have the value of the geometry, and the standard deviation of the joint covariance of the walls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from slam.errors import MapError
from slam.measuring.map_measurements import measure_map, measure_walls, wall_lengths
from slam.measuring.measurement import Kind, Measurement, measure_angle, measure_distance, measure_length
from slam.measuring.outlines import STEP_COST, _bridge_cost, wall_edges
from slam.measuring.rooms import build_room, find_rooms, measure_room, outline_along
from slam.measuring.visible_pairs import measure_pairs
from slam.measuring.wall_map import WallMap

from .plans import around, moved, room, wall_map

TRAPEZIUM = [(0.0, 0.0), (5.0, 0.3), (5.4, 4.2), (0.2, 4.0)]


def _area(plan: WallMap) -> Measurement:
    return measure_room(plan, find_rooms(plan)[0])[0]


def _perimeter(plan: WallMap) -> Measurement:
    return measure_room(plan, find_rooms(plan)[0])[1]


QUANTITIES: dict[str, Callable[[WallMap], Measurement]] = {
    "length": lambda plan: measure_length(plan, 0, 1, 2),
    "distance": lambda plan: measure_distance(plan, 0, 2, along=0.4),
    "angle": lambda plan: measure_angle(plan, 1, 2),
    "area": _area,
    "perimeter": _perimeter,
}


@pytest.mark.parametrize("name", QUANTITIES)
def test_a_standard_deviation_is_that_of_the_quantity_if_the_walls_move(name: str) -> None:
    """A covariance v v' allows only one motion of all walls, in which every quantity changes by its deviation."""
    measure, random = QUANTITIES[name], np.random.default_rng(3)
    plan = wall_map(room(TRAPEZIUM), around(4))
    for _ in range(5):
        motion = random.normal(0.0, 1e-4, 8)
        stated = measure(replace(plan, covariance=np.outer(motion, motion))).sigma
        change = 0.5 * (measure(moved(plan, motion)).value - measure(moved(plan, -motion)).value)
        assert stated == pytest.approx(abs(change), rel=1e-3, abs=1e-9)


def test_errors_in_common_cancel_in_a_distance_or_add_up() -> None:
    walls = [[(0.0, 0.0), (4.0, 0.0)], [(4.0, 3.0), (0.0, 3.0)]]
    farther = np.array([1e-3, 0.0, 1e-3, 0.0])  # both walls appear 1 mm nearer, as if ranges were too short
    shifted = np.array([1e-3, 0.0, -1e-3, 0.0])  # both move in the same direction
    sums, cancels = (wall_map(walls, covariance=np.outer(v, v)) for v in (farther, shifted))
    assert measure_distance(sums, 0, 1).sigma == pytest.approx(2e-3)
    assert measure_distance(cancels, 0, 1).sigma == pytest.approx(0.0, abs=1e-9)


def test_a_room_has_the_area_of_its_outline_without_the_islands() -> None:
    pillar = [(1.0, 2.0), (1.0, 3.0), (2.0, 3.0), (2.0, 2.0)]
    shape = [(0.0, 0.0), (6.0, 0.0), (6.0, 2.5), (4.0, 2.5), (4.0, 4.0), (0.0, 4.0)]
    plan = wall_map([*room(shape), *room(pillar)], [*around(6), *around(4, 6)], path=[(0.5, 0.5), (5.0, 1.0)])
    (found,) = find_rooms(plan)
    assert found.area == pytest.approx(6.0 * 2.5 + 4.0 * 1.5 - 1.0)
    assert found.perimeter == pytest.approx(20.0)
    assert found.observed == pytest.approx(1.0)
    angles = [one.value for one in measure_room(plan, found) if one.kind is Kind.ANGLE]
    assert sum(angles) == pytest.approx(4.0 * np.pi)
    assert max(angles) == pytest.approx(1.5 * np.pi)


def test_an_outline_is_closed_across_a_door_and_a_hidden_corner() -> None:
    walls = [
        [(0.0, 0.0), (2.0, 0.0), (3.0, 0.0), (5.0, 0.0)],  # with a door, which the robot came through
        [(5.0, 0.0), (5.0, 3.2)],  # a cupboard hides the corner (5, 4)
        [(4.2, 4.0), (0.0, 4.0)],
        [(0.0, 4.0), (0.0, 0.0)],
    ]
    plan = wall_map(walls, [(0, 1), (2, 3), (3, 0)], path=[(2.5, -2.0), (2.5, 2.0)])
    (found,) = find_rooms(plan)
    assert found.area == pytest.approx(20.0)
    assert found.observed == pytest.approx(1.0 - (1.0 + 0.8 + 0.8) / 18.0)


@pytest.mark.parametrize(
    ("path", "extra"),
    [
        ([(7.0, 1.0), (8.0, 1.0)], []),  # the robot was not inside
        ([(1.0, 1.0), (4.6, 3.9), (6.0, 5.0)], []),  # it drove through the gap at the corner, which is no corner
        ([(1.0, 1.0), (2.0, 1.5)], [[(4.7, 5.0), (4.7, 3.0)]]),  # another wall runs through it, seen from beyond
    ],
)
def test_no_room_is_made_up(path: list[tuple[float, float]], extra: list[list[tuple[float, float]]]) -> None:
    walls = [*room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]), *extra]
    walls[1], walls[2] = [(5.0, 0.0), (5.0, 3.2)], [(4.2, 4.0), (0.0, 4.0)]
    assert not find_rooms(wall_map(walls, [(0, 1), (2, 3), (3, 0)], path=path))


def test_walls_of_two_rooms_on_one_line_are_divided_by_the_partition() -> None:
    walls = [
        [(0.0, 0.0), (8.1, 0.0)],  # seen from both rooms
        *room([(4.0, 0.0), (4.0, 3.0), (0.0, 3.0), (0.0, 0.0)])[:3],
        *room([(8.1, 0.0), (8.1, 3.0), (4.1, 3.0), (4.1, 0.0)])[:3],
    ]
    walls[1], walls[6] = [(4.0, 0.2), (4.0, 3.0)], [(4.1, 3.0), (4.1, 0.2)]  # its foot was not seen
    corners = [(1, 2), (2, 3), (3, 0), (0, 4), (4, 5), (5, 6)]
    found = find_rooms(wall_map(walls, corners, path=[(1.0, 1.0), (2.0, 1.5), (6.0, 1.0)]))
    assert [one.area for one in found] == [pytest.approx(12.0)] * 2


def test_what_continues_a_divided_wall_does_not_depend_on_rounding() -> None:
    """The end of one piece is the begin of the next one, up to the last digit of their place on the wall."""
    walls = [[(0.0, 0.0), (12.0, 0.0)], *([(x, 3.0), (x, 0.0)] for x in (3.0, 6.0, 9.0))]
    plan, rng, costs = wall_map(walls), np.random.default_rng(3), set()
    for _ in range(12):
        one = moved(plan, rng.normal(0.0, 1e-7, 2 * len(walls)))
        edges = wall_edges(one)
        pieces = np.flatnonzero(edges.wall == 0)
        pieces = pieces[np.argsort(edges.span[pieces, 0])].tolist()
        costs |= {round(_bridge_cost(one, edges, *pair), 5) for pair in pairwise(pieces)}
    assert costs == {STEP_COST}


@pytest.mark.parametrize("common", [True, False])
def test_rooms_along_one_wall_do_not_depend_on_rounding(common: bool) -> None:
    walls = [[(0.0, 0.0), (12.2, 0.0)]]
    for left in (0.0, 4.1, 8.2):
        walls.append([(left + 4.0, 0.25), (left + 4.0, 3.0)])  # the foot was not seen
        walls += [] if common else [[(left + 4.0, 3.0), (left, 3.0)]]
        walls.append([(left, 3.0), (left, 0.25)])
    walls += [[(12.2, 3.0), (0.0, 3.0)]] if common else []
    plan, rng = wall_map(walls, path=[(1.0, 1.0), (5.0, 1.5), (10.0, 1.0)]), np.random.default_rng(3)
    for _ in range(12):
        found = find_rooms(moved(plan, rng.normal(0.0, 1e-7, 2 * len(walls))))
        assert [one.area for one in found] == [pytest.approx(12.0, abs=1e-3)] * 3


def test_an_outline_is_closed_across_a_door_beside_a_corner() -> None:
    walls = room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)])
    walls[2] = [(4.1, 4.0), (0.0, 4.0)]  # the robot came through the rest
    (found,) = find_rooms(wall_map(walls, [(0, 1), (2, 3), (3, 0)], path=[(4.5, 6.0), (4.5, 2.0)]))
    assert found.area == pytest.approx(20.0)
    assert found.observed == pytest.approx(1.0 - 0.9 / 18.0)


def test_an_outline_steps_to_an_open_door_leaf_and_from_it() -> None:
    leaf = [(4.8, 3.9), (4.1, 3.6)]  # in front of a wall that is seen from x = 3.9 m on
    walls = [*room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]), leaf]
    walls[2] = [(3.9, 4.0), (0.0, 4.0)]
    corners = [(0, 1), (2, 3), (3, 0)]
    (found,) = find_rooms(wall_map(walls, corners))
    assert 20.0 - 0.5 < found.area < 20.0
    assert list(found.outline.walls).count(-1) == 1  # it continues along the leaf to the side wall
    measured = measure_room(wall_map(walls, corners), found)
    assert (Kind.LENGTH, (14,)) not in [
        (one.kind, one.walls) for one in measured
    ]  # where a step begins is not measured
    walls[4] = [leaf[1], leaf[0]]  # seen from the other side, it is none of this room
    assert 14 not in {wall for room in find_rooms(wall_map(walls, corners)) for wall in room.outline.walls}


def test_a_wall_seen_beyond_a_corner_adds_nothing_to_the_outline() -> None:
    walls = room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)])
    walls[0] = [(-1.5, 0.0), (7.0, 0.0)]  # the next rooms have their walls on the same line
    (found,) = find_rooms(wall_map(walls, around(4)))
    assert found.area == pytest.approx(20.0)


def test_an_outline_follows_a_wall_through_a_hidden_corner_if_it_is_seen_from_the_room() -> None:
    walls = [*room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]), [(4.7, 3.0), (4.7, 5.0)]]
    walls[1], walls[2] = [(5.0, 0.0), (5.0, 3.0)], [(4.2, 4.0), (0.0, 4.0)]
    (found,) = find_rooms(wall_map(walls, [(0, 1), (2, 3), (3, 0)], path=[(1.0, 1.0), (2.0, 1.5)]))
    assert found.area == pytest.approx(20.0 - 0.3)


def test_an_open_door_leaf_in_the_room_is_left_out_of_its_outline() -> None:
    leaf = [(3.2, 3.3), (2.65, 3.95)]  # hinged where the robot came in
    walls = [*room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]), leaf]
    walls[2] = [(5.0, 4.0), (3.3, 4.0), (1.8, 4.0), (0.0, 4.0)]  # the leaf hides a part of the wall
    (found,) = find_rooms(wall_map(walls, [(0, 1), (1, 2), (2, 3), (3, 0)], path=[(2.1, 6.0), (2.1, 2.0)]))
    assert found.area == pytest.approx(20.0)
    assert found.observed == pytest.approx(1.0 - 1.5 / 18.0)


def test_a_corner_with_a_wall_of_the_next_room_does_not_open_the_outline() -> None:
    beyond = [(-0.1, 4.1), (-0.1, 7.0)]  # seen from the west, through a window
    walls = [*room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]), beyond]
    walls[2] = [(5.0, 4.0), (0.02, 4.0)]
    (found,) = find_rooms(wall_map(walls, [(0, 1), (1, 2), (2, 4), (3, 0)]))
    assert found.area == pytest.approx(20.0)


def test_widths_and_thicknesses_are_those_of_walls_with_nothing_in_between() -> None:
    walls = [
        [(0.0, 0.0), (4.0, 0.0)],  # seen from above
        [(4.0, 3.0), (0.0, 3.0)],  # facing it
        [(0.0, 3.2), (4.0, 3.2)],  # the other side of the same wall
        [(4.0, 6.0), (0.0, 6.0)],
        [(5.0, -1.0), (5.0, 2.0)],
    ]
    found = {(one.kind, one.walls): one.value for one in measure_pairs(wall_map(walls))}
    assert found == {
        (Kind.WIDTH, (10, 11)): pytest.approx(3.0),
        (Kind.WIDTH, (12, 13)): pytest.approx(2.8),
        (Kind.THICKNESS, (11, 12)): pytest.approx(0.2),
    }


def test_a_wall_has_a_length_between_two_corners_only() -> None:
    corners = [(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]
    plan = wall_map(room(corners), [(0, 1), (1, 2)])
    assert [one.value for row in range(4) for one in wall_lengths(plan, row)] == [pytest.approx(4.0)]


def test_selected_walls_are_measured_one_by_one_and_in_pairs() -> None:
    plan = wall_map(room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]), around(4))
    found = [(one.kind, one.walls, round(one.value, 9)) for one in measure_walls(plan, [10, 12, 11])]
    assert found == [
        (Kind.LENGTH, (10,), 5.0),
        (Kind.LENGTH, (12,), 5.0),
        (Kind.LENGTH, (11,), 4.0),
        (Kind.DISTANCE, (10, 12), 4.0),
        (Kind.ANGLE, (10, 12), round(np.pi, 9)),
        (Kind.ANGLE, (10, 11), round(np.pi / 2, 9)),
        (Kind.ANGLE, (12, 11), round(np.pi / 2, 9)),
    ]
    with pytest.raises(MapError, match="no wall 99"):
        measure_walls(plan, [99])


def test_sides_of_rooms_are_listed_once() -> None:
    plan = wall_map(room(TRAPEZIUM), around(4))
    lengths = [one.walls for one in measure_map(plan, find_rooms(plan)) if one.kind is Kind.LENGTH]
    assert sorted(lengths) == [(10,), (11,), (12,), (13,)]


def test_two_parallel_walls_of_an_outline_are_connected_by_a_step() -> None:
    walls = [
        [(0.0, 0.0), (2.0, 0.0)],
        [(2.4, 0.1), (5.0, 0.1)],
        [(5.0, 0.1), (5.0, 4.0)],
        [(5.0, 4.0), (0.0, 4.0)],
        [(0.0, 4.0), (0.0, 0.0)],
    ]
    (found,) = find_rooms(wall_map(walls, [(1, 2), (2, 3), (3, 4), (4, 0)]))
    assert found.area == pytest.approx(20.0 - 0.1 * 2.8)
    same = build_room(wall_map(walls), 1, outline_along(wall_map(walls), found.outline.stretches), [])
    assert same.area == found.area


def test_the_place_of_a_step_does_not_depend_on_the_directions_of_its_walls() -> None:
    """Walls a metre apart turn by their errors; a place that followed would move by as many metres per radian."""
    walls = [
        [(0.0, 0.0), (2.0, 0.0)],
        [(2.4, 1.0), (5.0, 1.0)],
        [(5.0, 1.0), (5.0, 4.0)],
        [(5.0, 4.0), (0.0, 4.0)],
        [(0.0, 4.0), (0.0, 0.0)],
    ]
    plan, random = wall_map(walls, [(1, 2), (2, 3), (3, 4), (4, 0)]), np.random.default_rng(5)
    (found,) = find_rooms(plan)
    assert -1 in found.outline.walls
    motion = random.normal(0.0, 1e-4, 10)
    values = [outline_along(moved(plan, sign * motion), found.outline.stretches).perimeter for sign in (-1.0, 0.0, 1.0)]
    assert values[1] == found.perimeter
    change = 0.5 * (values[2] - values[0])
    assert found.outline.perimeter_gradient @ motion == pytest.approx(change, rel=1e-3, abs=1e-9)

"""A scan's pose is measured relative to a keyframe by the surfaces that this one has seen."""

from __future__ import annotations

import numpy as np

from slam.geometry.segments import Floats
from slam.matching.point_matcher import point_information
from slam.matching.shared_points import split_information

LEFT, RIGHT, BACK = (0.0, -1.0), (0.0, 1.0), (-1.0, 0.0)
"""Normals of the walls to the left and right of a robot in a corridor along x, and of surfaces ahead of it."""


def surface(start: tuple[float, float], end: tuple[float, float], normal: tuple[float, float]) -> Floats:
    """Return points (p, 6) every 5 cm along a surface."""
    count = int(np.hypot(*np.subtract(end, start)) / 0.05) + 1
    return np.column_stack([np.linspace(start, end, count), np.tile((*normal, 1.0, 1.0), (count, 1))])


def corridor(reach: float, *doors: float) -> Floats:
    """Return the walls within `reach` metres, and the jambs of doors some metres ahead."""
    walls = [surface((-reach, y), (reach, y), normal) for y, normal in ((1.0, LEFT), (-1.0, RIGHT))]
    jambs = [surface((x, 1.0), (x, 1.15), BACK) for x in doors if abs(x) < reach]
    return np.concatenate(walls + jambs)


def seen_from(x: float, reach: float, *doors: float) -> Floats:
    return corridor(reach, *(door - x for door in doors))


def shares(scan: Floats, x: float, *references: tuple[float, Floats]) -> list[Floats]:
    """Return for each reference the shares (3,) of the information along, across and of the heading.

    scan        seen from x
    references  x from where they were seen, and their points
    """
    information = point_information(scan)
    relatives = [np.array([x - at, 0.0, 0.0]) for at, _ in references]
    parts = dict(split_information(information, [reference for _, reference in references], scan, relatives))
    np.testing.assert_allclose(sum(parts.values()), information, rtol=1e-9, atol=1e-6 * np.trace(information))
    assert min(np.linalg.eigvalsh(part)[0] for part in parts.values()) > -1e-6 * np.trace(information)
    return [np.diag(parts.get(row, np.zeros((3, 3)))) / np.diag(information) for row in range(len(references))]


def test_all_information_in_a_room_is_from_surfaces_that_both_have_seen() -> None:
    room = np.concatenate([corridor(3.0), surface((3.0, -1.0), (3.0, 1.0), BACK)])
    scan = room - [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
    oldest, latest = shares(scan, 0.5, (0.0, room), (0.5, scan))
    assert (oldest > 0.999).all()
    assert not latest.any()


def test_the_place_along_a_corridor_is_measured_by_those_that_have_seen_its_doors() -> None:
    doors = 2.0, 8.0
    scan = seen_from(4.0, 6.0, *doors[1:])  # the first one is behind its jambs
    (along, across, _), latest = shares(scan, 4.0, (0.0, seen_from(0.0, 6.0, *doors)), (4.0, scan))
    assert along < 1e-3
    assert across > 0.6
    assert latest[0] > 0.99
    (along, across, _), _ = shares(scan, 4.0, (3.0, seen_from(3.0, 6.0, *doors)), (4.0, scan))
    assert min(along, across) > 0.9


def test_surfaces_that_came_into_view_later_hold_what_has_drifted_since_then() -> None:
    doors = 2.0, 8.0
    scan = seen_from(4.0, 6.0, *doors[1:])
    passed = [(x, seen_from(x, 6.0, *doors)) for x in (0.0, 3.0, 3.5, 4.0)]
    oldest, second, third, latest = shares(scan, 4.0, *passed)
    assert oldest[1] > 0.6
    assert second[0] > 0.9
    assert max(third[0], latest[0]) < 1e-3


def test_a_reference_has_seen_at_least_half_of_what_is_left() -> None:
    scan, end = corridor(3.0), surface((3.0, -1.0), (3.0, 1.0), BACK)
    left, right = scan[scan[:, 1] > 0.0], scan[scan[:, 1] < 0.0]
    oldest, second, latest = shares(np.concatenate([scan, end]), 0.0, (0.0, left), (0.0, end), (0.0, right))
    assert oldest[1] > 0.4
    assert not second.any()
    assert latest[0] > 0.99


def test_the_other_side_of_a_wall_is_another_surface() -> None:
    scan, reference = surface((2.0, -1.0), (2.0, 1.0), BACK), surface((2.1, -1.0), (2.1, 1.0), (1.0, 0.0))
    scan, reference = (np.concatenate([corridor(1.9), wall]) for wall in (scan, reference))
    assert shares(scan, 0.0, (0.0, reference), (0.0, scan))[0][0] < 1e-3


def test_what_has_moved_shows_nothing() -> None:
    end = surface((3.0, -1.0), (3.0, 1.0), BACK)
    person, walls = surface((1.5, 0.0), (1.5, 0.4), BACK), corridor(2.9)
    scan = np.concatenate([walls, person])
    information = point_information(scan)
    parts = dict(split_information(information, [np.concatenate([walls, end]), scan], scan, [np.zeros(3)] * 2))
    along, across, _ = np.diag(sum(parts.values())) / np.diag(information)
    assert along < 1e-3
    assert across > 0.99


def test_a_scan_without_points_has_no_information() -> None:
    assert not split_information(np.zeros((3, 3)), [corridor(3.0)] * 2, np.zeros((0, 6)), [np.zeros(3)] * 2)

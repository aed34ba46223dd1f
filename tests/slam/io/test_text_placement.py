"""Texts of dimension lines do not cover each other."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from slam.geometry.segments import Floats
from slam.io.exports.dimension_lines import AREA_TEXT_HEIGHT, DimensionLine, dimension_lines
from slam.io.exports.text_placement import overlaps, place_texts, placed_areas, text_box
from slam.measuring.measured_map import measure_all

from ..measuring.plans import around, room, wall_map

NOTHING = np.zeros((0, 5))
PILLAR = [(2.0, 1.5), (2.0, 2.5), (3.0, 2.5), (3.0, 1.5)]
PILLAR_BOX = [2.5, 2.0, 0.0, 0.5, 0.5]


def line(start: tuple[float, float], end: tuple[float, float], text: str = "5.000 ± 0.001") -> DimensionLine:
    ends = np.array([start, end], dtype=float)
    return DimensionLine(ends, ends, text, "")


def boxes(placed: list[tuple[DimensionLine, Floats]]) -> list[Floats]:
    return [text_box(place, one.text, one.angle) for one, place in placed]


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ([0.0, 0.0, 0.0, 2.0, 0.1], True),
        ([2.9, 0.0, 0.0, 2.0, 0.1], True),
        ([3.1, 0.0, 0.0, 2.0, 0.1], False),
        ([0.0, 0.25, 0.0, 1.0, 0.1], False),
        ([0.0, 1.9, np.pi / 2, 2.0, 0.1], True),
        ([0.0, 2.2, np.pi / 2, 2.0, 0.1], False),
        ([1.3, 0.8, np.pi / 4, 1.0, 0.1], True),  # its lower end is just above the box's right half
        ([1.7, 0.35, np.pi / 4, 1.0, 0.1], False),  # the boxes around both overlap, they do not
    ],
)
def test_boxes_overlap_unless_an_edge_separates_them(other: list[float], expected: bool) -> None:
    box, others = np.array([0.0, 0.0, 0.0, 1.0, 0.1]), np.array([other])
    assert overlaps(box, others).tolist() == [expected]
    assert overlaps(others[0], box[None]).tolist() == [expected]


def test_a_single_text_is_above_the_middle_of_its_line() -> None:
    ((found, place),) = place_texts([one := line((0.0, 0.0), (4.0, 4.0))], NOTHING)
    assert found is one
    np.testing.assert_allclose(place, [2.0, 2.0])
    x, y, angle, *_ = text_box(place, one.text, one.angle)
    assert angle == pytest.approx(np.pi / 4)
    assert (x - 2.0, y - 2.0) == pytest.approx((-(y - 2.0), y - 2.0))
    assert y > 2.0


def test_texts_of_lines_that_cross_are_apart_and_cross_no_line() -> None:
    lines = [line((-5.0, 0.0), (5.0, 0.0)), line((0.0, -3.0), (0.0, 3.0)), line((-2.0, -2.0), (2.0, 2.0))]
    placed = place_texts(lines, NOTHING)
    assert [one for one, _ in placed] == lines
    for first, second in itertools.combinations(boxes(placed), 2):
        assert not overlaps(first, second[None]).any()
    for (one, place), box in zip(placed, boxes(placed), strict=True):
        along = one.line[1] - one.line[0]
        assert np.linalg.det([along, place - one.line[0]]) == pytest.approx(0.0, abs=1e-9)
        others = [
            np.array([*other.middle, other.angle, 0.5 * np.hypot(*np.ptp(other.line, axis=0)), 0.0])
            for other in lines
            if other is not one
        ]
        assert not overlaps(box, np.array(others)).any()


def test_a_line_without_room_for_its_text_is_left_out() -> None:
    wide, narrow = line((0.0, 0.0), (9.0, 0.0)), line((0.0, 1.0), (1.5, 1.0))
    given = text_box(np.array([0.75, 1.0]), "door 1: 1.0 m", 0.0)
    assert [one for one, _ in place_texts([wide, narrow], given[None])] == [wide]
    assert [one for one, _ in place_texts([wide, narrow], NOTHING)] == [wide, narrow]


def test_the_text_of_a_room_is_inside_it_and_crosses_fewer_lines_than_elsewhere() -> None:
    walls = [*room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]), *room(PILLAR)]
    measured = measure_all(wall_map(walls, [*around(4), *around(4, 4)], path=[(1.0, 1.0), (1.0, 2.0)]))
    ((place, text),) = placed_areas(measured)
    lines = dimension_lines(measured.measurements)
    strokes = np.array([[*one.middle, one.angle, 0.5 * np.hypot(*(one.line[1] - one.line[0])), 0.0] for one in lines])

    def is_inside(box: Floats) -> bool:
        corners = box[:2] + box[3:] * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        return bool(measured.rooms[0].contains(corners).all()) and not overlaps(box, np.array([PILLAR_BOX])).any()

    box = text_box(place, text, 0.0, AREA_TEXT_HEIGHT)
    assert is_inside(box)
    assert not is_inside(text_box(np.array([2.5, 1.9]), text, 0.0, AREA_TEXT_HEIGHT))
    others = [text_box(np.array([x, y]), text, 0.0, AREA_TEXT_HEIGHT) for x in (2.0, 2.5, 3.0) for y in (0.3, 0.9, 3.0)]
    crossed = [int(overlaps(other, strokes).sum()) for other in others if is_inside(other)]
    assert len(crossed) > 3
    assert overlaps(box, strokes).sum() <= min(crossed)

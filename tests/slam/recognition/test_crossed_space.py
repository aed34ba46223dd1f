"""Points contradict a map where its beams have passed through, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from slam.geometry.segments import Floats
from slam.mapping.mapper import Mapper
from slam.recognition.crossed_space import CrossedSpace
from slam.recognition.map_index import index_map
from slam.recognition.scanned_map import ScannedMap, scan_map

BEAMS = np.radians(np.arange(-60.0, 61.0, 0.5))
WALL = 4.0
"""Metres ahead of the robot."""


def scanned(hidden_from: float) -> ScannedMap:
    """Return a map of two scans of a wall ahead, whose part beyond y = `hidden_from` (metres) is hidden."""
    y = WALL * np.tan(BEAMS)
    y = y[y < hidden_from]
    ones = np.ones(len(y))
    wall = np.column_stack([WALL * ones, y, -ones, 0.0 * ones, 0.0 * ones, ones])
    return scan_map(index_map(Mapper()), np.zeros((2, 3)), [wall, wall])


def judged(points: Floats, by: ScannedMap) -> tuple[float, float]:
    """Return how many points without normals a map judges, and by how much they misfit."""
    column = np.zeros(len(points))
    scan = np.column_stack([points, column, column, column, column + 1.0])
    misfits, known = np.zeros((2, 10000))
    scan_map(index_map(Mapper()), np.zeros((1, 3)), [scan]).points.add_misfits(by, np.zeros(3), misfits, known)
    return float(known.sum()), float(misfits.sum())


def test_the_rest_of_a_wall_is_no_misfit() -> None:
    """The last beam ends at y = 1 m: from 0.1 m beyond, points are on no surface that the map knows."""
    rest = np.column_stack([np.full(10, WALL), np.arange(1.15, 2.15, 0.1)])
    known, misfits = judged(rest, scanned(hidden_from=1.0))
    assert misfits == 0.0
    assert known < 2
    known, misfits = judged(rest, scanned(hidden_from=10.0))
    assert known == 10
    assert misfits < 0.5


def test_a_wall_along_which_beams_graze_is_no_misfit() -> None:
    """Their ends are up to metres apart, and before it ends, each beam is for a metre within 0.1 m of the wall.

    The points that are judged are off the wall by usual noise.
    """
    x = 1.0 / np.tan(np.radians(np.arange(3.0, 45.0)))
    ones = np.ones(len(x))
    seen = scan_map(
        index_map(Mapper()),
        np.zeros((1, 3)),
        [np.column_stack([x, ones, 0.0 * ones, -ones, 0.0 * ones, ones])],
    )
    _, misfits = judged(np.column_stack([np.arange(1.0, 19.0, 0.1), np.full(180, 0.97)]), seen)
    assert misfits < 1.0


@pytest.mark.parametrize("distance", [0.5, 1.0, 3.0, WALL - 0.5])
def test_what_beams_have_passed_through_is_a_misfit(distance: float) -> None:
    known, misfits = judged(np.array([[distance, 0.0], [distance, 0.5]]), scanned(hidden_from=10.0))
    assert known == 2
    assert misfits > 1.8


def test_nothing_is_known_behind_walls_and_outside() -> None:
    assert judged(np.array([[WALL + 0.5, 0.0], [-1.0, 0.0], [1e3, 0.0]]), scanned(hidden_from=10.0)) == (0.0, 0.0)


def test_a_surface_is_not_crossed_by_the_beams_that_end_on_it() -> None:
    ends = np.column_stack([np.full(len(BEAMS), WALL), WALL * np.tan(BEAMS)])
    space = CrossedSpace.of_beams(np.zeros_like(ends), ends)
    row = int((WALL - space.corner[0]) / 0.1)
    assert not space.crossed[row].any()
    assert space.crossed[: row - 3].any(axis=1).all()


def test_no_beams_cross_nothing() -> None:
    assert not CrossedSpace.of_beams(np.zeros((0, 2)), np.zeros((0, 2))).crossed.any()

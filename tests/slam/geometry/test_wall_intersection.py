"""Intersections of walls lie on both of them, and their Jacobians follow the walls."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from slam.geometry.wall_intersection import intersect_walls

FIRST = np.array([[1.0, 2.0, 0.3], [-4.0, 0.5, 1.2], [0.0, 0.0, -2.0]])
SECOND = np.array([[3.0, -1.0, 1.9], [2.0, 2.0, -0.4], [5.0, 1.0, 0.2]])


def test_intersections_of_many_walls_are_those_of_each_pair() -> None:
    points, jacobians = intersect_walls(FIRST, SECOND)
    for first, second, point, jacobian in zip(FIRST, SECOND, points, jacobians, strict=True):
        alone, of_both = intersect_walls(first, second)
        np.testing.assert_allclose(alone, point, rtol=0, atol=1e-12)
        np.testing.assert_allclose(of_both, jacobian, rtol=0, atol=1e-12)
        for wall in (first, second):
            assert se2.transform(se2.inverse(wall), point)[1] == pytest.approx(0.0, abs=1e-12)


def test_jacobian_is_that_of_offset_and_heading_of_both_walls() -> None:
    point, jacobian = intersect_walls(FIRST[0], SECOND[0])
    for column in range(4):
        step = np.zeros(3)
        step[1 + column % 2] = 1e-6
        moved = [FIRST[0], SECOND[0]]
        moved[column // 2] = se2.compose(moved[column // 2], step)
        np.testing.assert_allclose((intersect_walls(*moved)[0] - point) / 1e-6, jacobian[:, column], atol=1e-4)

"""Consecutive views of a driving robot agree; those of a kidnapped robot differ."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import Floats
from slam.localisation.view_change import View

from ..outlines import outline

ORIGIN = np.zeros(3)


ROOM = outline([(-2, -1), (3, -1), (3, 1), (1.5, 1), (1.5, 3), (-2, 3)])
OTHER = outline([(-4, -2.5), (1.2, -2.5), (1.2, 5), (-0.5, 5), (-0.5, 2), (-4, 2)])


def seen_from(pose: list[float], room: Floats = ROOM) -> View:
    """Return the view of a room from a pose in it, with odometry at the origin."""
    return View(ORIGIN, se2.transform(se2.inverse(np.array(pose)), room))


@pytest.mark.parametrize("motion", [[0.0, 0.0, 0.0], [0.4, 0.1, 0.3], [0.0, 0.0, -0.8]])
@pytest.mark.parametrize("error", [0.0, 0.12, -0.2])
def test_views_of_a_driving_robot_do_not_differ(motion: list[float], error: float) -> None:
    """Even if odometry's turn is wrong."""
    x, y, turn = motion
    assert not seen_from([0.0, 0.0, 0.0]).differs_from(seen_from(motion), np.array([x, y, turn + error]))


@pytest.mark.parametrize("pose", [[0.0, 0.0, 0.0], [-1.5, 0.7, 1.0], [0.3, 3.0, -2.0]])
def test_views_of_different_rooms_differ(pose: list[float]) -> None:
    assert seen_from([0.0, 0.0, 0.0]).differs_from(seen_from(pose, OTHER), ORIGIN)


def test_views_with_few_points_are_not_compared() -> None:
    nothing = View(ORIGIN, ROOM[:5])
    assert not nothing.differs_from(seen_from([0.0, 0.0, 0.0], OTHER), ORIGIN)
    assert not seen_from([0.0, 0.0, 0.0]).differs_from(nothing, ORIGIN)


def test_views_from_far_apart_are_not_compared() -> None:
    far = np.array([1.5, 0.0, 0.0])
    assert not seen_from([0.0, 0.0, 0.0]).differs_from(seen_from([0.0, 0.0, 0.0], OTHER), far)

"""What a robot sees goes on from scan to scan where it drives, and breaks off where it is carried away."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import Floats
from slam.localisation.view_change import View

from ..outlines import outline

NEVER_REMOVED = np.zeros(3)


ROOM = outline([(-2, -1), (3, -1), (3, 1), (1.5, 1), (1.5, 3), (-2, 3)])
OTHER = outline([(-4, -2.5), (1.2, -2.5), (1.2, 5), (-0.5, 5), (-0.5, 2), (-4, 2)])


def seen_from(pose: list[float], room: Floats = ROOM) -> View:
    """What is seen of a room from a pose in it, while odometry has not moved."""
    return View(NEVER_REMOVED, se2.transform(se2.inverse(np.array(pose)), room))


@pytest.mark.parametrize("motion", [[0.0, 0.0, 0.0], [0.4, 0.1, 0.3], [0.0, 0.0, -0.8]])
@pytest.mark.parametrize("error", [0.0, 0.12, -0.2])
def test_a_view_goes_on_where_the_robot_drives(motion: list[float], error: float) -> None:
    """Also where odometry errs in turning."""
    x, y, turn = motion
    assert not seen_from([0.0, 0.0, 0.0]).differs_from(seen_from(motion), np.array([x, y, turn + error]))


@pytest.mark.parametrize("pose", [[0.0, 0.0, 0.0], [-1.5, 0.7, 1.0], [0.3, 3.0, -2.0]])
def test_a_view_breaks_off_where_the_robot_is_carried_to_another_room(pose: list[float]) -> None:
    assert seen_from([0.0, 0.0, 0.0]).differs_from(seen_from(pose, OTHER), NEVER_REMOVED)


def test_next_to_nothing_seen_says_nothing() -> None:
    nothing = View(NEVER_REMOVED, ROOM[:5])
    assert not nothing.differs_from(seen_from([0.0, 0.0, 0.0], OTHER), NEVER_REMOVED)
    assert not seen_from([0.0, 0.0, 0.0]).differs_from(nothing, NEVER_REMOVED)


def test_views_from_far_apart_say_nothing() -> None:
    far = np.array([1.5, 0.0, 0.0])
    assert not seen_from([0.0, 0.0, 0.0]).differs_from(seen_from([0.0, 0.0, 0.0], OTHER), far)

"""Consecutive views of a driving robot agree; those of a kidnapped robot differ."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.messages import Odometry
from slam.config import OdometryConfig
from slam.geometry.segments import Floats
from slam.localisation.view_change import View, ViewComparison
from slam.odometry.dead_reckoning import DeadReckoning
from slam.odometry.error_model import OdometryModel

from ..outlines import outline, visible

ORIGIN = np.zeros(3)
READING = Odometry(0.0, ORIGIN)


ROOM = outline([(-2, -1), (3, -1), (3, 1), (1.5, 1), (1.5, 3), (-2, 3)])
OTHER = outline([(-4, -2.5), (1.2, -2.5), (1.2, 5), (-0.5, 5), (-0.5, 2), (-4, 2)])


def seen_from(pose: list[float], room: Floats = ROOM) -> View:
    """Return the view of a room from a pose in it, with odometry at the origin."""
    return View(READING, visible(room, np.array(pose)))


@pytest.mark.parametrize("motion", [[0.0, 0.0, 0.0], [0.02, 0.0, 0.1], [0.0, 0.0, -0.15]])
@pytest.mark.parametrize("error", [0.0, 0.12, -0.2])
def test_views_of_one_room_do_not_differ(motion: list[float], error: float) -> None:
    """Even if odometry's turn is wrong."""
    x, y, turn = motion
    assert not seen_from([0.0, 0.0, 0.0]).differs_from(seen_from(motion), np.array([x, y, turn + error]))


@pytest.mark.parametrize("pose", [[0.0, 0.0, 0.0], [-1.5, 0.7, 1.0], [0.3, 3.0, -2.0]])
def test_views_of_different_rooms_differ(pose: list[float]) -> None:
    assert seen_from([0.0, 0.0, 0.0]).differs_from(seen_from(pose, OTHER), ORIGIN)


def test_views_with_few_points_are_not_compared() -> None:
    nothing = View(READING, ROOM[:5])
    assert not nothing.differs_from(seen_from([0.0, 0.0, 0.0], OTHER), ORIGIN)
    assert not seen_from([0.0, 0.0, 0.0]).differs_from(nothing, ORIGIN)


@pytest.mark.parametrize("motion", [[0.2, 0.0, 0.0], [0.0, 0.0, 0.9]])
def test_a_view_that_changes_while_the_robot_drives_is_no_evidence(motion: list[float]) -> None:
    """What comes into sight behind other surfaces, or into the lidar's range, may be all that is seen then."""
    before, after = seen_from([0.0, 0.0, 0.0]), seen_from([0.0, 0.0, 0.0], OTHER)
    assert before.differs_from(after, 0.1 * np.array(motion))
    assert not before.differs_from(after, np.array(motion))


def test_points_out_of_range_are_no_evidence() -> None:
    """Outdoors nearly all returns may be far away, and others are in range at each scan."""
    far, farther = (np.column_stack([np.linspace(-r, r, 80), np.full(80, r)]) for r in (14.0, 20.0))
    assert not View(READING, far).differs_from(View(READING, farther), ORIGIN)


@pytest.mark.parametrize("covered", [0.4, 1.0])
def test_what_touches_the_robot_is_no_evidence(covered: float) -> None:
    """Its bearing changes by a large angle if the robot moves by some centimetres, and it may be on the robot."""
    free, angles = seen_from([0.0, 0.0, 0.0]), np.linspace(-covered * np.pi, covered * np.pi, 500)
    beyond = free.points[np.abs(np.arctan2(free.points[:, 1], free.points[:, 0])) > covered * np.pi]
    touching = View(READING, np.concatenate([0.3 * np.column_stack([np.cos(angles), np.sin(angles)]), beyond]))
    assert not free.differs_from(touching, ORIGIN)
    assert not touching.differs_from(free, ORIGIN)


@pytest.mark.parametrize("spacing", [1, 4, 16])
def test_the_beams_may_be_far_apart(spacing: int) -> None:
    """Between two beams the surface continues: points of the next scan may lie anywhere on it."""
    before = View(READING, seen_from([0.0, 0.0, 0.0]).points[::spacing])
    same = View(READING, seen_from([0.03, 0.0, 0.1]).points[spacing // 2 :: spacing])
    other = View(READING, seen_from([0.0, 0.0, 0.0], OTHER).points[::spacing])
    assert not before.differs_from(same, np.array([0.03, 0.0, 0.0]))
    assert before.differs_from(other, ORIGIN)


@pytest.mark.parametrize("fits_nowhere", [False, True])
def test_a_sweep_in_which_the_robot_is_lifted_does_not_hide_the_change(fits_nowhere: bool) -> None:
    """It shows one room at first and then the other one, and agrees with both."""
    odometry, comparison = DeadReckoning(OdometryModel(OdometryConfig())), ViewComparison()
    before, after = seen_from([0.0, 0.0, 0.0]), seen_from([0.0, 0.0, 0.0], OTHER)
    halves = np.concatenate([before.points[before.points[:, 1] < 0.0], after.points[after.points[:, 1] >= 0.0]])
    for view in (before, View(READING, halves)):
        assert not comparison.add(view, odometry, suspicious=False, fits_nowhere=False)
    assert comparison.add(after, odometry, suspicious=True, fits_nowhere=fits_nowhere) is fits_nowhere

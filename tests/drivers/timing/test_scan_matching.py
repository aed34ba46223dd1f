"""Matching of scans for their timing."""

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Floats, Scan
from drivers.timing.scan_matching import BIN, MAX_REFERENCE_POINTS, find_rotation, match, surface

SIZE = np.array([8.0, 5.0])
"""Metres, sides of the room."""


def room(beams: int, pose: se2.Pose) -> Floats:
    """Return the points (beams, 2) that a lidar at `pose` measures in a room, in its own frame."""
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    directions = np.column_stack([np.cos(angles + pose[2]), np.sin(angles + pose[2])])
    with np.errstate(divide="ignore"):
        reach = np.maximum((SIZE - pose[:2]) / directions, -pose[:2] / directions).min(axis=1)
    return np.asarray(reach[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]))


@pytest.mark.parametrize("beams", [360, 3200])
def test_many_beams_need_no_more_points_and_give_the_same_motion(beams: int) -> None:
    """Lidars with thousands of beams took minutes, as all of their points were compared."""
    before, after = np.array([3.0, 2.0, 0.1]), np.array([3.05, 2.02, 0.2])
    reference = surface(room(beams, before))
    assert reference is not None
    assert len(reference.points) <= MAX_REFERENCE_POINTS
    found = match(room(beams, after), reference, np.zeros(3))
    assert found is not None
    assert np.abs(se2.between(before, after) - found.pose).max() < 1e-3


@pytest.mark.parametrize("turn", [-0.2, 0.0, 0.16])
@pytest.mark.parametrize("view", [0.5, 1.0, 2 * np.pi])
def test_scans_that_have_nothing_in_common_do_not_agree(view: float, turn: float) -> None:
    """As those of a depth camera that is turned by more than its view."""

    def scan(heading: float) -> Scan:
        points = room(720, np.array([3.0, 2.0, heading]))
        angles = np.arctan2(points[:, 1], points[:, 0])
        seen = np.flatnonzero(np.abs(angles) <= 0.5 * view)
        seen = seen[np.argsort(angles[seen])]
        return Scan(0.0, np.hypot(*points[seen].T), angles[seen], np.zeros(len(seen)), 0.0, np.inf)

    assert find_rotation(scan(0.5 + turn), scan(0.5)) == pytest.approx(turn, abs=2 * BIN)

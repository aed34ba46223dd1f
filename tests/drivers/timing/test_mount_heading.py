"""The direction that a lidar points in is found from its motions, and contradicts a wrong mount only."""

from __future__ import annotations

import numpy as np
import pytest

import drivers
from drivers import se2
from drivers.messages import Scan
from drivers.timing.mount_heading import MountHeading, estimate_mount_heading
from drivers.timing.turns import Turns

from .drives import office_drive, with_turned_lidar


@pytest.mark.parametrize("heading", [0.0, 1.6, -2.5, np.pi])
def test_the_heading_is_found(heading: float) -> None:
    found = estimate_mount_heading(Turns(with_turned_lidar(office_drive(), heading)))
    assert found is not None
    assert abs(se2.wrap(found.found - heading)) < 4 * found.sigma
    assert found.sigma < 0.03
    assert found.stated is None
    assert found.contradicts(0.0) == (heading != 0.0)
    assert not found.contradicts(heading)


def test_the_mount_that_scans_state_is_not_contradicted() -> None:
    found = estimate_mount_heading(Turns(office_drive()))
    assert found is not None
    assert found.stated is not None
    assert not found.contradicts(found.stated[2])


def test_an_uncertain_heading_contradicts_nothing() -> None:
    assert not MountHeading(None, 3.1, 1.0, 20).contradicts(0.0)
    assert MountHeading(None, 3.1, 0.1, 20).contradicts(0.0)
    assert not MountHeading(None, 0.34, 1e-6, 20).contradicts(0.0)


def test_nothing_is_found_without_motion_or_odometry() -> None:
    scans = [message for message in office_drive() if isinstance(message, Scan)]
    assert estimate_mount_heading(Turns(scans)) is None
    assert estimate_mount_heading(Turns([])) is None
    assert estimate_mount_heading(Turns(drivers.open("sim:corridor?duration=5&lidar=short"))) is None

"""The localisation status follows its table of transitions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slam.geometry.segments import Floats
from slam.localisation.state import (
    CONFIRMING_SCANS,
    TRANSITIONS,
    LocalisationEvent,
    LocalisationState,
    LocalisationStateMachine,
    LocalisationStatus,
)
from slam.localisation.tracking import TrackingResult, TrackingStatus

from ..tracking_results import tracking_result

CERTAIN = np.diag([1e6, 1e6, 1e6])
OPEN_ALONG_X = np.diag([1e-2, 1e6, 1e6])


def tracked(information: Floats, status: TrackingStatus = TrackingStatus.TRACKED) -> TrackingResult:
    return tracking_result(status, information=information, known=0)


def test_every_status_can_be_reached_and_left() -> None:
    assert {status for status, _ in TRANSITIONS} == set(LocalisationStatus)
    assert set(TRANSITIONS.values()) == set(LocalisationStatus)
    for status in LocalisationStatus:
        assert any(old is status and new is not status for (old, _), new in TRANSITIONS.items())


def test_a_lost_robot_becomes_ok_only_by_relocalisation_odometry_or_a_larger_map() -> None:
    ends = {event for (status, event), new in TRANSITIONS.items() if status == "LOST" and new != "LOST"}
    assert ends == {
        LocalisationEvent.RELOCALISED,
        LocalisationEvent.PLACED_BY_ODOMETRY,
        LocalisationEvent.PART_IS_LARGEST,
    }


def test_a_bare_corridor_is_degenerate_along_its_direction_after_some_scans() -> None:
    machine = LocalisationStateMachine()
    changes = [machine.update(tracked(OPEN_ALONG_X)) for _ in range(CONFIRMING_SCANS + 2)]
    assert changes[: CONFIRMING_SCANS - 1] == [None] * (CONFIRMING_SCANS - 1)
    change = changes[CONFIRMING_SCANS - 1]
    assert change is not None
    assert change.status is LocalisationStatus.DEGENERATE
    assert change.direction is not None
    assert min(change.direction, math.pi - change.direction) == pytest.approx(0.0, abs=1e-6)
    assert changes[CONFIRMING_SCANS:] == [None, None]


def test_single_scans_do_not_change_the_status() -> None:
    machine = LocalisationStateMachine()
    for _ in range(5):
        for _ in range(CONFIRMING_SCANS - 1):
            assert machine.update(tracked(OPEN_ALONG_X)) is None
        assert machine.update(tracked(CERTAIN)) is None
    assert machine.state == LocalisationState(LocalisationStatus.OK)


@pytest.mark.parametrize("status", [TrackingStatus.FAILED, TrackingStatus.TENTATIVE, TrackingStatus.NO_FEATURES])
def test_scans_that_were_not_tracked_do_not_count(status: TrackingStatus) -> None:
    machine = LocalisationStateMachine()
    for _ in range(2 * CONFIRMING_SCANS):
        assert machine.update(tracked(OPEN_ALONG_X, status)) is None


def test_a_change_is_returned_once() -> None:
    machine = LocalisationStateMachine()
    assert machine.handle(LocalisationEvent.TRACKING_LOST) == LocalisationState(LocalisationStatus.LOST)
    assert machine.lost
    assert machine.handle(LocalisationEvent.RELOCALISED) == LocalisationState(LocalisationStatus.OK)
    assert machine.handle(LocalisationEvent.RELOCALISED) is None
    assert not machine.lost

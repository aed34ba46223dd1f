"""Notices that the publisher makes of tracked scans."""

from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from slam.events import Event, Notice
from slam.localisation.tracking import TrackingStatus
from slam.reporting.publisher import Publisher


class Notices:
    """Sink of notices alone."""

    handled: ClassVar[tuple[type[Event], ...]] = (Notice,)

    def __init__(self) -> None:
        self.levels: list[str] = []
        self.texts: list[str] = []

    def handle(self, event: Any) -> None:
        self.levels.append(event.level)
        self.texts.append(event.text)


def tracking_at(x: float, *, slipped: bool) -> Any:
    """Return the result of a scan that was tracked at (x, 0, 0)."""
    return SimpleNamespace(slipped=slipped, status=TrackingStatus.TRACKED, pose=np.array([x, 0.0, 0.0]))


@pytest.mark.parametrize(("slip", "expected"), [(0.05, ["TRACE"]), (0.5, ["INFO"]), (None, [])])
def test_a_slip_is_a_message_if_it_is_large_and_nothing_before_the_first_tracked_scan(
    slip: float | None, expected: list[str]
) -> None:
    notices = Notices()
    publisher = Publisher([notices])
    mapper: Any = SimpleNamespace(keyframe_count=2)
    model: Any = None
    scan: Any = SimpleNamespace(stamp=1.0, odometry=np.array([7.0, 0.0, 0.0]))
    if slip is not None:
        publisher.publish_tracking(scan, tracking_at(0.0, slipped=False), mapper, model)
    publisher.publish_tracking(scan, tracking_at(slip or 0.5, slipped=True), mapper, model)
    assert notices.levels == expected


def test_odometry_that_is_often_far_off_is_one_warning() -> None:
    notices = Notices()
    publisher = Publisher([notices])
    mapper: Any = SimpleNamespace(keyframe_count=2)
    model: Any = None
    for stamp, x in enumerate((0.0, 0.5, 2.0, 2.3)):  # odometry stands still
        scan: Any = SimpleNamespace(stamp=float(stamp), odometry=np.zeros(3))
        publisher.publish_tracking(scan, tracking_at(x, slipped=stamp > 0), mapper, model)
    publisher.publish_deviations(4)
    assert notices.levels == ["INFO", "TRACE", "TRACE", "WARN"]
    assert notices.texts[-1] == "odometry was far off at 3 of 4 scans, most by 1.50 m and 0.0°; the scans were used"


def test_there_is_no_warning_of_odometry_that_was_never_far_off() -> None:
    notices = Notices()
    Publisher([notices]).publish_deviations(4)
    assert notices.levels == []

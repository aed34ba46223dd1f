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
    scan: Any = SimpleNamespace(stamp=1.0, odometry=np.array([7.0, 0.0, 0.0]), measured=True)
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
        scan: Any = SimpleNamespace(stamp=float(stamp), odometry=np.zeros(3), measured=True)
        publisher.publish_tracking(scan, tracking_at(x, slipped=stamp > 0), mapper, model)
    publisher.publish_deviations(4)
    assert notices.levels == ["INFO", "TRACE", "TRACE", "WARN"]
    assert notices.texts[-1] == "odometry was far off at 3 of 4 scans, most by 1.50 m and 0.0°; the scans were used"


def test_there_is_no_warning_of_odometry_that_was_never_far_off() -> None:
    notices = Notices()
    Publisher([notices]).publish_deviations(4)
    assert notices.levels == []


def test_stretches_on_which_the_scans_show_nothing_are_one_warning_if_they_last() -> None:
    """A robot that was carried with a covered lidar left a map displaced by 1.3 m, and no message."""
    notices = Notices()
    publisher = Publisher([notices])
    mapper: Any = SimpleNamespace(keyframe_count=2)
    model: Any = None
    blind = SimpleNamespace(slipped=False, status=TrackingStatus.NO_FEATURES)
    for spans in ([(1.0, 1.2)], [(1.0, 1.2), (2.0, 3.5), (5.0, 5.8)]):
        for k in range(80):
            scan: Any = SimpleNamespace(stamp=0.1 * k, odometry=np.zeros(3), measured=True)
            covered = any(first <= scan.stamp <= last for first, last in spans)
            publisher.publish_tracking(scan, blind if covered else tracking_at(0.0, slipped=False), mapper, model)
        publisher.publish_stretches()
    (text,) = notices.texts
    assert text.startswith("the scans showed nothing for 1.5 s, the longest of 2 times: ")

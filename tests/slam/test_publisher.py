"""Notices that the publisher makes of tracked scans."""

from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from slam.events import Event, Notice
from slam.publisher import Publisher


class Notices:
    """Sink of notices alone."""

    handled: ClassVar[tuple[type[Event], ...]] = (Notice,)

    def __init__(self) -> None:
        self.levels: list[str] = []

    def handle(self, event: Any) -> None:
        self.levels.append(event.level)


def keyframe_at(pose: np.ndarray) -> Any:
    """Return a mapper whose last keyframe is at a pose."""
    return SimpleNamespace(pose=pose, keyframe_count=2)


@pytest.mark.parametrize(("slip", "expected"), [(0.05, ["TRACE"]), (0.5, ["WARN"]), (None, [])])
def test_a_slip_is_a_warning_if_it_is_large_and_nothing_before_the_first_keyframe(
    slip: float | None, expected: list[str]
) -> None:
    notices = Notices()
    publisher = Publisher([notices])
    scan: Any = SimpleNamespace(stamp=1.0, odometry=np.array([7.0, 0.0, 0.0]))
    if slip is not None:
        update: Any = SimpleNamespace(merge=None, loop=None, superseded=None)
        publisher.publish_keyframe(scan, keyframe_at(np.zeros(3)), update, 0.01, timer=None)  # type: ignore[arg-type]
    tracking: Any = SimpleNamespace(slipped=True, pose=np.array([slip or 0.5, 0.0, 0.0]))
    publisher.publish_tracking(scan, tracking, keyframe_at(np.zeros(3)), None)  # type: ignore[arg-type]
    assert notices.levels == expected

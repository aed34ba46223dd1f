"""Detect odometry that stands still while the robot moves, as seen by its lidar.

Encoders that are unplugged, a stalled driver or a robot that is carried repeat the last pose. If the robot stood, its
scans would repeat too, apart from noise and from people, who cover a part of the view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..elapsed import elapsed
from ..messages import Message, Odometry, Scan

MIN_DURATION = 5.0
"""Seconds. Origin: chosen; in good recordings, odometry that is computed rarely stands still for up to 1 s."""
MIN_CHANGES = 3
"""Changes of the view. Origin: chosen; one may be a door or somebody who steps before the lidar."""
CHANGED_SHARE = 2.0 / 3.0
"""Share of the beams whose range must change. Origin: chosen; people rarely cover a third of the view, and a third
elsewhere if they move."""
MIN_CHANGE = (0.1, 0.05)
"""Change of a range, in metres and as a share of the range. Origin: data sheets; above the noise of cheap lidars."""


@dataclass(frozen=True, slots=True)
class FrozenOdometry:
    """Time in which the odometry stood still while the scans changed: start (stamp) and duration, seconds."""

    start: float
    duration: float


class FrozenOdometryDetector:
    """Detector that is given all messages of a recording in time order."""

    def __init__(self) -> None:
        self.found: list[FrozenOdometry] = []
        self._first: float | None = None  # stamp of the first message
        self._pose: list[float] | None = None
        self._start = self._end = 0.0  # stamps of the first and last odometry with this pose
        self._view: Scan | None = None  # the first scan, or the last one that was found changed
        self._changes = 0

    def add(self, message: Message) -> None:
        """Process the next message."""
        if self._first is None:
            self._first = message.stamp
        if isinstance(message, Odometry):
            pose = message.pose.tolist()
            if pose != self._pose:
                self.finish()
                self._pose, self._start = pose, message.stamp
            self._end = message.stamp
        elif isinstance(message, Scan) and self._pose is not None:
            if self._view is None or len(self._view.ranges) != len(message.ranges):
                self._view = message
            elif _has_changed(self._view, message):
                self._view, self._changes = message, self._changes + 1

    def finish(self) -> None:
        """Process the end of a pose, or of the recording."""
        if self._changes >= MIN_CHANGES and self._end - self._start >= MIN_DURATION:
            self.found.append(FrozenOdometry(self._start, self._end - self._start))
        self._view, self._changes = None, 0

    def describe(self) -> str | None:
        """Return one line of text on what was found, None if that is nothing."""
        if not self.found:
            return None
        longest = max(self.found, key=lambda frozen: frozen.duration)
        times = "once" if len(self.found) == 1 else f"{len(self.found)} times"
        when = f"the longest {longest.duration:.1f} s at {elapsed(longest.start - (self._first or 0.0))}"
        return f"odometry stands still while the scans change ({times}, {when})"


def _has_changed(before: Scan, after: Scan) -> bool:
    both = ~(np.isnan(before.ranges) | np.isnan(after.ranges))
    if not np.any(both):
        return False
    old, new = before.ranges[both], after.ranges[both]
    return bool(np.mean(np.abs(new - old) > np.maximum(MIN_CHANGE[0], MIN_CHANGE[1] * old)) > CHANGED_SHARE)

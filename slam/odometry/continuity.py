"""Odometry without jumps that no robot can make.

A base that starts again counts from another pose, and a damaged reading may be anywhere. Tracking, which compares
odometry with the scans, handles slips. But a motion of kilometres exceeds what a map and its covariances can represent.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.messages import Odometry

# Metres, and metres per second, from which a motion between two readings is a jump. Origin: chosen, more than any
# wheeled robot drives, and less than what a map cannot represent.
MIN_JUMP, MIN_JUMP_SPEED = 100.0, 100.0
# Metres from which a motion is a jump however long it took: it says nothing about the robot then. Origin: chosen.
MAX_UNSEEN = 1000.0


class ContinuousOdometry:
    """Odometry without its jumps: after a jump it goes on from the reading before, as if the robot had stood meanwhile.

    jumped  True if the last reading came after a jump
    """

    def __init__(self) -> None:
        self.jumped = False
        self._last: Odometry | None = None
        self._offset: se2.Pose | None = None  # of the readings' frame before all jumps; None before the first

    def continued(self, reading: Odometry) -> Odometry:
        """Return the next reading with its pose in the frame of the first one."""
        pose = reading.pose if self._offset is None else se2.compose(self._offset, reading.pose)
        last = self._last
        self.jumped = last is not None and _is_jump(last, pose, reading.stamp)
        if last is not None and self.jumped:
            self._offset, pose = se2.compose(last.pose, se2.inverse(reading.pose)), last.pose
        self._last = reading if pose is reading.pose else replace(reading, pose=pose)
        return self._last


def _is_jump(last: Odometry, pose: se2.Pose, stamp: float) -> bool:
    """Return True if a robot can hardly have moved from a reading to `pose` (3,) at `stamp` seconds."""
    distance = float(np.hypot(*(pose - last.pose)[:2]))
    return distance > MIN_JUMP and distance > min(MAX_UNSEEN, MIN_JUMP_SPEED * (stamp - last.stamp))

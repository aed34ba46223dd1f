"""Odometry segments of a session: parts in which odometry is continuous."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.messages import Odometry

from ..geometry.segments import Floats
from ..odometry.continuity import MAX_BREAK
from ..odometry.history import OdometryHistory
from ..odometry.velocity import MAX_VELOCITIES
from .trajectory_builder import TrajectoryBuilder

# A reading continues a segment if the robot can have driven there since the last reading: a program was stopped and
# started again, while the base went on counting.
# Metres per second. Origin: definition, no indoor robot is faster.
MAX_SPEED = float(MAX_VELOCITIES[0])
# Metres by which the position may differ besides. Origin: chosen, more than the noise of a reading; not measured.
POSITION_TOLERANCE = 0.2


class OdometrySegments:
    """All odometry of a session, one history per segment.

    histories  odometry readings of each segment
    starts     for each segment, the index of its first scan among all scans of the session
    """

    def __init__(self, histories: Sequence[OdometryHistory] = (), starts: Sequence[int] = ()) -> None:
        self.histories, self.starts = list(histories), list(starts)

    @property
    def last_reading(self) -> Odometry | None:
        """Last reading; None without one."""
        if not self.histories or not len(self.histories[-1]):
            return None
        history = self.histories[-1]
        return Odometry(float(history.stamps[-1]), history.poses[-1])

    @property
    def latest(self) -> float:
        """Stamp of the last reading, -inf without one."""
        return max((history.latest for history in self.histories), default=-np.inf)

    def is_continued_by(self, reading: Odometry) -> bool:
        """Return True if a reading continues the last segment."""
        if not self.histories or not len(self.histories[-1]):
            return False
        gap = reading.stamp - self.latest
        moved = float(np.hypot(*(reading.pose - self.histories[-1].poses[-1])[:2]))
        return 0.0 <= gap <= MAX_BREAK and moved <= POSITION_TOLERANCE + MAX_SPEED * gap

    def begin(self, start: int) -> OdometryHistory:
        """Begin a segment whose first scan has the index `start`, and return its empty history."""
        self.histories.append(OdometryHistory())
        self.starts.append(start)
        return self.histories[-1]

    def keep_last(self) -> None:
        """Drop all but the last segment; its scans are numbered from zero then."""
        self.histories, self.starts = self.histories[-1:], [0]

    def trajectory(self, trajectory: TrajectoryBuilder, keyframe_poses: Floats) -> tuple[Floats, Floats]:
        """Return stamps (m,) and poses (m, 3) at every reading and scan of the segments that have a registered scan."""
        begin = [-np.inf, *(float(history.stamps[0]) for history in self.histories[1:]), np.inf]
        parts = [
            trajectory.clip(begin[k], begin[k + 1]).path(keyframe_poses, history)
            for k, history in enumerate(self.histories)
        ]
        return np.concatenate([stamps for stamps, _ in parts]), np.concatenate([poses for _, poses in parts])

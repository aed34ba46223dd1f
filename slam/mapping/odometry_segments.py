"""The drives of a session: within one odometry continues, from one to the next it does not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.messages import Odometry

from ..geometry.segments import Floats
from ..odometry.history import OdometryHistory
from .trajectory_builder import TrajectoryBuilder

# What comes so soon after the last reading, from where the robot can have come to in the meantime, is the same drive: a
# program that was stopped and started again, while the base went on counting.
LONGEST_BREAK = 60.0  # seconds
FASTEST = 1.0  # metres a second
JITTER = 0.2  # metres


class OdometrySegments:
    """All odometry of a session, drive by drive; `starts` are the rows of the sightings that they begin with."""

    def __init__(self, histories: Sequence[OdometryHistory] = (), starts: Sequence[int] = ()) -> None:
        self.histories, self.starts = list(histories), list(starts)

    @property
    def latest(self) -> float:
        """Stamp of the last reading, -inf without one."""
        return max((history.latest for history in self.histories), default=-np.inf)

    def is_continued_by(self, reading: Odometry) -> bool:
        """Whether a reading continues the last drive."""
        if not self.histories or not len(self.histories[-1]):
            return False
        gap = reading.stamp - self.latest
        moved = float(np.hypot(*(reading.pose - self.histories[-1].poses[-1])[:2]))
        return 0.0 <= gap <= LONGEST_BREAK and moved <= JITTER + FASTEST * gap

    def begin(self, row: int) -> OdometryHistory:
        """A new drive, whose first sighting will be in this row."""
        self.histories.append(OdometryHistory())
        self.starts.append(row)
        return self.histories[-1]

    def keep_last(self) -> None:
        """Forget all but the last drive."""
        self.histories, self.starts = self.histories[-1:], [0]

    def trajectory(self, path: TrajectoryBuilder, keyframe_poses: Floats) -> tuple[Floats, Floats]:
        """Stamps (m,) and poses (m, 3) at every reading of the drives of which any scan was placed."""
        begin = [-np.inf, *(float(history.stamps[0]) for history in self.histories[1:]), np.inf]
        parts = [
            path.between(begin[k], begin[k + 1]).at_odometry(keyframe_poses, history)
            for k, history in enumerate(self.histories)
        ]
        return np.concatenate([stamps for stamps, _ in parts]), np.concatenate([poses for _, poses in parts])

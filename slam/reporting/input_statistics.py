"""Messages of a run on their way to the pipeline: shift of their stamps, and statistics of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.timestamps import follows

from ..geometry.growing_array import GrowingArray
from ..io.tum import Trajectory
from ..odometry.continuity import MAX_BREAK


@dataclass(slots=True)
class InputStatistics:
    """Statistics of the messages of a run: counts, time span, odometry poses and true poses.

    keeps_odometry  keep the odometry poses, to draw them: memory then grows with time
    shift           seconds that were added to all stamps
    first, last     stamps of measurements, seconds; infinite if there is none
    """

    keeps_odometry: bool = False
    scans: int = 0
    odometry: int = 0
    shift: float = 0.0
    first: float = np.inf
    last: float = -np.inf
    odometry_poses: GrowingArray = field(default_factory=lambda: GrowingArray((3,)))
    _truth: list[GroundTruth] = field(default_factory=list)

    def read(self, messages: Iterable[Message], after: float = -np.inf) -> Iterator[Message]:
        """Yield the messages and count them; shift all stamps to just after `after` (seconds), as `shift_after` says.

        after  last stamp of the session that the run uses; without one -inf
        """
        for stated in messages:
            if self.first == np.inf:
                self.shift = shift_after(stated.stamp, after)
            message = replace(stated, stamp=stated.stamp + self.shift) if self.shift else stated
            self._add(message)
            yield message

    def _add(self, message: Message) -> None:
        """Count a message."""
        if isinstance(message, GroundTruth):
            self._truth.append(message)
            return
        self.first, self.last = min(self.first, message.stamp), max(self.last, message.stamp)
        if isinstance(message, Odometry):
            self.odometry += 1
            if self.keeps_odometry:
                self.odometry_poses.append(message.pose)
        elif isinstance(message, Scan):
            self.scans += 1

    @property
    def truth(self) -> Trajectory | None:
        """True poses; None if there are none."""
        if not self._truth:
            return None
        return Trajectory(np.array([one.stamp for one in self._truth]), np.array([one.pose for one in self._truth]))

    @property
    def duration(self) -> float:
        """Seconds from the first measurement to the last."""
        return max(0.0, self.last - self.first)


def shift_after(first: float, after: float) -> float:
    """Return the seconds by which stamps are shifted if the first one does not follow `after`, else zero.

    Such stamps do not tell what happened in between: they follow so late that no run seems to have been interrupted.
    """
    return 0.0 if first == after or follows(first, after) else float(np.ceil(after - first)) + MAX_BREAK + 1.0

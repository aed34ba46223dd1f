"""Logs that GMapping has written: CARMEN logs in which odometry goes on from GMapping's own estimate after each scan.

    ODOM ...          the motion since the last scan, from the estimate there
    FLASER ...        with the estimate as its pose
    ODOM x y theta    the estimate again; its stamp is not set

Public logs are often such "corrected" ones. The odometry of the wheels is restored from the motions between scans.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import se2
from ..messages import Floats

MIN_CORRECTED = 2
"""Scans that are needed, beside most of all, whose estimate differs from the odometry before and is repeated."""


def remove_estimates(lines: list[bytes]) -> bool:
    """Empty the ODOM lines that repeat the estimate of the scan before, if GMapping has written the log.

    Returns whether it has; not if most scans have no other pose than the odometry.
    """
    estimates: list[int] = []  # indices of lines
    scans, corrected, pose, before = 0, 0, list[bytes](), list[bytes]()
    for index, line in enumerate(lines):
        kind = line[:12].partition(b" ")[0]
        if kind == b"FLASER":
            scans, pose = scans + 1, _pose(line.split())
        elif kind == b"ODOM":
            odometry = line.split()[1:4]
            if pose and odometry == pose:
                estimates.append(index)
                # else the robot stands still, the scan has the odometry's pose, or there is no other odometry
                corrected += bool(before) and before != pose
                odometry = []
            pose, before = [], odometry
    if corrected < MIN_CORRECTED or 2 * corrected <= scans:
        return False
    for index in estimates:
        lines[index] = b""
    return True


def _pose(words: Sequence[bytes]) -> list[bytes]:
    """Return x, y and theta of a FLASER line; nothing if it is incomplete."""
    try:
        first = 2 + max(0, int(words[1]))
    except (IndexError, ValueError):
        return []
    return list(words[first : first + 3])


class WheelOdometry:
    """Odometry of the wheels, restored line by line from a log that GMapping has written."""

    def __init__(self) -> None:
        self._origin: se2.Pose | None = None  # from which the log's odometry goes on
        self._at_origin, self._last = np.zeros(3), np.zeros(3)
        self._has_odometry = False  # since the last scan

    def restore(self, pose: Floats) -> se2.Pose:
        """Return the wheels' odometry (3,) for the pose (3,) of an ODOM line."""
        if self._origin is None:
            self._origin = self._at_origin = pose
        self._last = se2.compose(self._at_origin, se2.between(self._origin, pose))
        self._has_odometry = True
        return self._last

    def go_on_from(self, estimate: Floats) -> se2.Pose:
        """Return the wheels' odometry (3,) at a scan, from whose estimate (3,) the log's odometry goes on.

        If there is none since the scan before, only the estimates tell how the robot moved.
        """
        if not self._has_odometry:
            self.restore(estimate)
        self._origin, self._at_origin, self._has_odometry = estimate, self._last, False
        return self._last

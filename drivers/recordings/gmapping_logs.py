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


def remove_estimates(lines: list[bytes]) -> set[int]:
    """Empty the ODOM lines that repeat the estimate of the scan before, if GMapping has written the log.

    Returns the numbers, from 1 on, of the scans' lines; nothing if most scans have no other pose than the odometry.
    """
    estimates: list[tuple[int, int]] = []  # line numbers of scans and of their estimates
    scans, corrected, scan, pose, before = 0, 0, 0, list[bytes](), list[bytes]()
    for number, line in enumerate(lines, start=1):
        kind = line[:12].partition(b" ")[0]
        if kind == b"FLASER":
            scans, scan, pose = scans + 1, number, _pose(line.split())
        elif kind == b"ODOM":
            odometry = line.split()[1:4]
            if pose and odometry == pose:
                estimates.append((scan, number))
                # else the robot stands still, the scan has the odometry's pose, or there is no other odometry
                corrected += bool(before) and before != pose
                odometry = []
            pose, before = [], odometry
    if corrected < MIN_CORRECTED or 2 * corrected <= scans:
        return set()
    for _, number in estimates:
        lines[number - 1] = b""
    return {number for number, _ in estimates}


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

    def restore(self, pose: Floats) -> se2.Pose:
        """Return the wheels' odometry (3,) for the pose (3,) of an ODOM line."""
        if self._origin is None:
            self._origin = self._at_origin = pose
        self._last = se2.compose(self._at_origin, se2.between(self._origin, pose))
        return self._last

    def go_on_from(self, estimate: Floats) -> se2.Pose:
        """Return the wheels' odometry (3,) at a scan, from whose estimate (3,) the log's odometry goes on."""
        self._origin, self._at_origin = estimate, self._last
        return self._last

"""Logs whose clock stands: nearly all lines have one stamp, so that only the order of the lines is known.

A program that converts a log may not know the times, and write zero. Another one prints a date of ten digits with six
digits that count. Speeds then cannot be known. The lines get stamps as if the robot had driven at a usual speed: what
depends on time, as how far a robot can have moved from scan to scan, is of the right order of magnitude.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from .. import se2
from ..messages import Floats
from .carmen_lines import LASERS, written_stamps

MIN_SCANS = 10
"""Scans of one stamp from which the clock stands. Origin: chosen; a few may be of one burst."""
SPEED = 0.5
"""m/s. Origin: chosen; robots that map with a 2-D lidar drive at 0.2 to 1 m/s."""
TURN_RATE = 0.5
"""rad/s. Origin: chosen, likewise."""
INTERVAL = 0.1
"""Seconds between two lines of one sensor at least, also if the robot stands. Origin: chosen; scanners and bases send 5
to 50 messages per second."""
LONGEST = 10.0
"""Seconds for a motion from line to line at most. Origin: chosen, 5 m; a longer step is a jump, not a drive."""


def clock_stands(lines: Sequence[bytes]) -> bool:
    """Return true if more than half of the scans of a laser have one and the same stamp."""
    stamps: dict[bytes, Counter[bytes]] = {kind: Counter() for kind in LASERS}
    for number, stamp in written_stamps(lines):
        kind = lines[number - 1][:12].partition(b" ")[0]
        if kind in stamps:
            stamps[kind][stamp] += 1
    most = max(stamps.values(), key=Counter.total)
    same = max(most.values(), default=0)
    return same >= MIN_SCANS and 2 * same > most.total()


class PathClock:
    """Clock that goes on with the robot's path, SPEED or TURN_RATE, from zero."""

    def __init__(self) -> None:
        self._stamp = 0.0
        self._pose: Floats | None = None
        self._last: dict[bytes, float] = {}  # stamp of the last line of each kind

    def stamp(self, kind: bytes, pose: Floats) -> float:
        """Return the stamp of the next line, of a kind; `pose` (3,) is the odometry there."""
        motion = np.zeros(3) if self._pose is None else se2.between(self._pose, pose)
        moved = max(float(np.hypot(motion[0], motion[1])) / SPEED, abs(float(motion[2])) / TURN_RATE)
        moved = min(moved, LONGEST)
        earliest = self._last[kind] + INTERVAL if kind in self._last else 0.0
        self._stamp = max(self._stamp + moved, earliest)
        self._pose, self._last[kind] = pose.copy(), self._stamp
        return self._stamp

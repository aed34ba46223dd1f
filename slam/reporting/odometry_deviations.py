"""Messages about odometry that deviates from the scans: the first large deviation at once, all together at the end."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from ..events import Notice

# Metres and radians by which odometry must deviate from the scans since the last tracked one for a warning; less is
# usual for worn wheels. Origin: chosen; not measured.
LARGE = 0.1, math.radians(10.0)


class OdometryDeviations:
    """Number of scans from which odometry was far off, and the largest deviation."""

    def __init__(self) -> None:
        self._count = 0
        self._worst = 0.0, 0.0, ""

    def add(self, stamp: float, deviation: se2.Pose) -> Notice:
        """Count a scan that odometry contradicts; return the message about it.

        The scans correct the path, so only the first large deviation of a run is of interest at once: wheels that slip
        do so often, a message for each would hide all others.

        stamp      of the scan, seconds
        deviation  motion since the last tracked scan by the scans, as seen from that by odometry
        """
        metres, radians = float(np.hypot(*deviation[:2])), abs(float(deviation[2]))
        off = _amount(metres, radians)
        size = max(metres / LARGE[0], radians / LARGE[1])
        if size <= 1.0:
            return Notice(stamp, f"odometry deviates by {off} from the scans since the last one", "TRACE")
        self._count += 1
        if size > self._worst[0]:
            self._worst = size, stamp, off
        text = f"odometry is off by {off} from the scan: wheels slipped or it jumped; the scan is used"
        return Notice(stamp, text, "INFO" if self._count == 1 else "TRACE")

    def summary(self, scans: int) -> Notice | None:
        """Return the warning at the end of a run of a number of `scans`, with the stamp of the largest deviation.

        None if odometry was never far off.
        """
        if not self._count:
            return None
        _, stamp, off = self._worst
        text = f"odometry was far off at {self._count} of {scans} scans, most by {off}; the scans were used"
        return Notice(stamp, text)


def _amount(metres: float, radians: float) -> str:
    return f"{metres:.2f} m and {math.degrees(radians):.1f}°"

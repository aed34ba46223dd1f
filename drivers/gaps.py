"""Gaps between messages, and odometry before the first scan and after the last one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .messages import Floats
from .path_length import path_length

GAP_RATIO = 4.0
"""A gap is longer than this ratio times the 90th percentile of the periods, and longer than MIN_GAP."""
MIN_GAP = 0.5
"""Seconds."""
MIN_LENGTH = 0.3
"""Metres that a robot drives at least where it matters that there are no scans: less of them would show nothing new."""


@dataclass(frozen=True, slots=True)
class UnseenStretch:
    """Stretch of a path before the first scan or after the last one.

    start     stamp of its begin
    duration  seconds
    length    metres
    """

    start: float
    duration: float
    length: float


def longest_period(stamps: Floats) -> float | None:
    """Return the seconds between two of the stamps (n,) from which on there is a gap; None if all are the same."""
    periods = np.diff(stamps)
    positive = periods[periods > 0]
    if not len(positive):
        return None
    typical = float(np.percentile(positive, 90, method="lower"))
    return max(GAP_RATIO * typical, MIN_GAP)


def unseen_stretches(scans: Floats, stamps: Floats, positions: Floats) -> list[UnseenStretch]:
    """Return the stretches of a path before the first scan and after the last one that are as long as gaps.

    scans      (m,) stamps of the scans in time order
    stamps     (n,) of the path, in time order
    positions  (n, 2) of the robot at these stamps, metres
    """
    if not len(stamps) or not len(scans) or (longest := longest_period(scans)) is None:
        return []
    spans = (float(stamps[0]), float(scans[0])), (float(scans[-1]), float(stamps[-1]))
    found = []
    for start, end in spans:
        length = path_length(positions[(stamps >= start) & (stamps <= end)])
        if end - start > longest and length >= MIN_LENGTH:
            found.append(UnseenStretch(start, end - start, length))
    return found

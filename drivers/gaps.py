"""Gaps between messages, scans without odometry, and odometry before the first scan and after the last one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .elapsed import elapsed
from .messages import Floats
from .path_length import path_length

GAP_RATIO = 4.0
"""A gap is longer than this ratio times the 90th percentile of the periods, and longer than MIN_GAP."""
MIN_GAP = 0.5
"""Seconds."""
MIN_LENGTH = 0.3
"""Metres driven without scans from which on there is a warning: on a shorter way, scans would show little else."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Pause without messages of one type: start (stamp) and duration, seconds."""

    start: float
    duration: float


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


def rate_and_gaps(stamps: Floats) -> tuple[float | None, list[Gap]]:
    """Return the mean rate outside of gaps (Hz), and the gaps; (None, []) if there are no two different stamps."""
    periods, longest = np.diff(stamps), _longest_period(stamps)
    if longest is None:
        return None, []
    is_gap = periods > longest
    gaps = [Gap(float(stamps[i]), float(periods[i])) for i in np.flatnonzero(is_gap)]
    return 1.0 / float(np.mean(periods[~is_gap])), gaps


def gap_warnings(scans: Floats, odometry: Floats) -> list[str]:
    """Return one line of text for each kind of gap in the stamps (n,) of the scans and (m,) of the odometry, seconds.

    Times in the texts are since the first stamp.
    """
    start = min((float(stamps[0]) for stamps in (scans, odometry) if len(stamps)), default=0.0)
    warnings = []
    for name, stamps in (("scans", scans), ("odometry", odometry)):
        _, gaps = rate_and_gaps(stamps)
        warnings += _longest_gap(name, gaps, start)
    return warnings + (_overlap_warnings(scans, odometry, start) if len(scans) and len(odometry) else [])


def _longest_gap(name: str, gaps: list[Gap], start: float) -> list[str]:
    if not gaps:
        return []
    longest = max(gaps, key=lambda gap: gap.duration)
    when = elapsed(longest.start - start)
    count = f"{len(gaps)} gap" if len(gaps) == 1 else f"{len(gaps)} gaps"
    return [f"{count} in the {name}, the longest {longest.duration:.1f} s at {when}"]


def _overlap_warnings(scans: Floats, odometry: Floats, start: float) -> list[str]:
    """Return warnings for scans before, after and in gaps of the odometry."""
    warnings = []
    if (lead := float(odometry[0] - scans[0])) > MIN_GAP:
        warnings.append(f"scans without odometry for {lead:.1f} s at {elapsed(scans[0] - start)}")
    if (tail := float(scans[-1] - odometry[-1])) > MIN_GAP:
        warnings.append(f"scans without odometry for {tail:.1f} s at {elapsed(odometry[-1] - start)}")
    after = np.searchsorted(odometry, scans)
    inside = (after > 0) & (after < len(odometry))
    wide = odometry[after[inside]] - odometry[after[inside] - 1]
    for last in np.unique(odometry[after[inside] - 1][wide > 10 * MIN_GAP])[:3]:
        following = odometry[np.searchsorted(odometry, last, side="right")]
        warnings.append(f"scans without odometry for {following - last:.1f} s at {elapsed(last - start)}")
    return warnings


def unseen_stretches(scans: Floats, stamps: Floats, positions: Floats) -> list[UnseenStretch]:
    """Return the stretches of a path before the first scan and after the last one that are as long as gaps.

    scans      (m,) stamps of the scans in time order
    stamps     (n,) of the path, in time order
    positions  (n, 2) of the robot at these stamps, metres
    """
    if not len(stamps) or not len(scans) or (longest := _longest_period(scans)) is None:
        return []
    spans = (float(stamps[0]), float(scans[0])), (float(scans[-1]), float(stamps[-1]))
    found = []
    for start, end in spans:
        length = path_length(positions[(stamps >= start) & (stamps <= end)])
        if end - start > longest and length >= MIN_LENGTH:
            found.append(UnseenStretch(start, end - start, length))
    return found


def _longest_period(stamps: Floats) -> float | None:
    """Return the longest period between stamps (n,) that is no gap, seconds; None if all stamps are the same."""
    periods = np.diff(stamps)
    positive = periods[periods > 0]
    if not len(positive):
        return None
    typical = float(np.percentile(positive, 90, method="lower"))
    return max(GAP_RATIO * typical, MIN_GAP)

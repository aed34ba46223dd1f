"""Warning of a lidar whose stamps are late against odometry's, during a run, which cannot look ahead."""

from __future__ import annotations

import numpy as np

from drivers.timing.student import ERROR_PROBABILITY, MIN_VALUES, upper_limit

from ..estimation.journal import Journal
from ..estimation.slam_state import SlamState
from ..events import Notice
from ..geometry.segments import Integers
from ..odometry.history import OdometryHistory
from ..odometry.scan_delay import ScanDelay, estimate_scan_delay
from .publisher import Publisher


class LidarDelayCheck:
    """Check of the delay each time the number of keyframes has doubled; one warning of it in a run."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self._next = MIN_VALUES  # keyframes at the next check
        self._is_known = False

    def update(self, state: SlamState, journal: Journal, stamp: float, *, ended: bool = False) -> None:
        """Check the delay if it is time, or the run has `ended`; publish it at a stamp (seconds) if it is significant.

        Few checks keep the probability of a false warning near that of one.
        """
        count = state.mapper.keyframe_count
        if self._is_known or count < MIN_VALUES or not (ended or count >= self._next):
            return
        self._next = 2 * count
        found = find_scan_delay(state, journal)
        if found is None or not found.significant:
            return
        interval = float(np.median(np.diff(_longest_history(state, journal)[1].stamps)))
        least = max(interval, found.sigma * upper_limit(ERROR_PROBABILITY / 2, count - 1))
        if abs(found.seconds) < least:  # between two readings of odometry the motion is only interpolated
            return
        self._is_known = True
        late = "early" if found.seconds < 0.0 else "late"
        text = f"lidar {abs(found.seconds):.3f} ± {found.sigma:.3f} s {late} against odometry, which bends the path"
        self._publisher.publish(Notice(stamp, f"{text}; add {found.seconds:.3f} to the setting lidar.delay"))


def find_scan_delay(state: SlamState, journal: Journal) -> ScanDelay | None:
    """Return the delay of the scans' stamps that is left, in the longest stretch of continuous odometry.

    None without odometry or keyframes.
    """
    if not state.odometry_model.measured or not state.keyframe_stamps:
        return None
    rows, history = _longest_history(state, journal)
    stamps = np.array(state.keyframe_stamps)[rows]
    return estimate_scan_delay(stamps, state.mapper.keyframe_poses[rows], history, state.odometry_model)


def _longest_history(state: SlamState, journal: Journal) -> tuple[Integers, OdometryHistory]:
    """Return the longest stretch of continuous odometry, and the rows (n,) of the keyframes that are in it."""
    stamps = np.array(state.keyframe_stamps)
    begins = np.array([-np.inf, *(history.stamps[0] for history in journal.segments.histories[1:])])
    segment = np.searchsorted(begins, stamps, side="right") - 1
    longest = int(np.bincount(segment).argmax())
    return np.flatnonzero(segment == longest), journal.segments.histories[longest]

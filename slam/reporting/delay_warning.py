"""Warning of a lidar whose stamps are late against odometry's, during a run, which cannot look ahead."""

from __future__ import annotations

import numpy as np

from drivers.timing.student import ERROR_PROBABILITY, MIN_VALUES, upper_limit

from ..estimation.journal import Journal
from ..estimation.slam_state import SlamState
from ..events import Notice
from ..odometry.scan_delay import ScanDelay, estimate_scan_delay
from .publisher import Publisher


class DelayWarning:
    """Warning of the delay, once in a run. It is estimated each time the number of keyframes has doubled."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self._next = MIN_VALUES  # keyframes at the next estimate
        self._is_published = False

    def update(self, state: SlamState, journal: Journal, stamp: float, *, ended: bool = False) -> None:
        """Estimate the delay if it is time, or the run has `ended`; warn of it if it is significant.

        Few estimates keep the probability of a false warning near that of one.

        stamp  of the warning, seconds
        """
        count = state.mapper.keyframe_count
        if self._is_published or count < MIN_VALUES or not (ended or count >= self._next):
            return
        self._next = 2 * count
        found = find_scan_delay(state, journal)
        limit = upper_limit(ERROR_PROBABILITY / 2, count - 1)
        if found is None or abs(found.seconds) < max(found.interval, limit * found.sigma):
            return
        self._is_published = True
        late = "early" if found.seconds < 0.0 else "late"
        text = f"lidar {abs(found.seconds):.3f} ± {found.sigma:.3f} s {late} against odometry, which bends the path"
        self._publisher.publish(Notice(stamp, f"{text}; add {found.seconds:.3f} to the setting lidar.delay"))


def find_scan_delay(state: SlamState, journal: Journal) -> ScanDelay | None:
    """Return the delay of the scans' stamps that is left, in the longest stretch of continuous odometry.

    None without odometry or keyframes.
    """
    if not state.odometry_model.measured or not state.keyframe_stamps:
        return None
    stamps = np.array(state.keyframe_stamps)
    begins = np.array([-np.inf, *(history.stamps[0] for history in journal.segments.histories[1:])])
    segment = np.searchsorted(begins, stamps, side="right") - 1
    longest = int(np.bincount(segment).argmax())
    rows = np.flatnonzero(segment == longest)
    history = journal.segments.histories[longest]
    return estimate_scan_delay(stamps[rows], state.mapper.keyframe_poses[rows], history, state.odometry_model)

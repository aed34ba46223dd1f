"""Detect scans of two sources on one topic, as of two robots of a simulator, which have one frame and one clock.

The view of one lidar changes by its motion, and it does not come back at once. If single scans are bad, the scan after
one is like that before it; the bad one is like none. So of the scans that differ from the last one, at most half are
like the view before that. Of two sources, all are, however often each of them sends. By the inequality of Hoeffding, s
of n scans show two sources with an error probability of exp(-2 n (s / n - 1/2)²) at most.

Lidars with several frames are told apart by their mounts on the robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ..messages import Floats, Message, Scan
from .own_returns import MIN_CHANGE, MIN_COMMON, farthest_returns
from .student import ERROR_PROBABILITY


@dataclass(slots=True)
class _Views:
    """Views of one lidar by its frame: farthest returns in each direction.

    last       of the last scan
    previous   of the last scan that differed from it
    changes    number of scans that differed from the last one, without the first
    reversals  number of these that were like the previous view
    """

    last: Floats
    previous: Floats | None = None
    changes: int = 0
    reversals: int = 0

    def add(self, view: Floats) -> None:
        """Compare the next scan; one that shows too little to be compared does not count."""
        if (same := _are_alike(view, self.last)) is None:
            return
        if same:
            self.last = view
            return
        if self.previous is not None:
            self.changes += 1
            self.reversals += bool(_are_alike(view, self.previous))
        self.last, self.previous = view, self.last

    @property
    def shows_two(self) -> bool:
        """True if the scans are of two sources."""
        excess = self.reversals - 0.5 * self.changes
        return excess > 0.0 and 2.0 * excess**2 > self.changes * math.log(1.0 / ERROR_PROBABILITY)


@dataclass(slots=True)
class AlternatingSources:
    """Detector that is given all messages of a drive in time order."""

    _views: dict[tuple[int, bytes | None], _Views] = field(default_factory=dict)

    def add(self, message: Message) -> None:
        """Process the next message."""
        if isinstance(message, Scan):
            view = farthest_returns(message)
            sensor = message.lidar, None if message.mount is None else message.mount.tobytes()
            views = self._views.setdefault(sensor, _Views(view))
            if views.last is not view:
                views.add(view)

    def describe(self) -> str | None:
        """Return what was found as a line of text; None if the scans of each lidar are of one source."""
        found = next((views for views in self._views.values() if views.shows_two), None)
        if found is None:
            return None
        return (
            f"the scans are of two sources, as two robots or programs that publish on one topic: {found.reversals} of "
            f"{found.changes} scans that differ from the last one are like the view before that; the map is wrong, as "
            "it shows what both see"
        )


def _are_alike(one: Floats, other: Floats) -> bool | None:
    """Return true if two views (BINS,) agree in most directions in which both have returns; None if these are few."""
    both = (one > 0.0) & (other > 0.0)
    common = np.count_nonzero(both)
    if common < MIN_COMMON:
        return None
    same = np.abs(one - other) <= MIN_CHANGE * np.maximum(one, other)
    return bool(2 * np.count_nonzero(both & same) >= common)

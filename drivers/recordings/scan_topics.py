"""Choose between several topics with scans of one recording.

Robots often publish scans more than once: raw, stamped anew, filtered, converted. A lidar rotates steadily, so scans
that are stamped with the time of their measurement follow each other evenly, also where some are lost. Scans that are
stamped when they are sent show the delays of the computer instead, and scans that were made from several others have
uneven or doubled stamps. The number of messages says nothing of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..messages import Scan

MAX_UNEVENNESS = 0.25
"""Deviation of a step from a whole number of periods, in periods. Origin: geometry; half of the steps of stamps without
any regularity keep it, all of a steady lidar's do."""


@dataclass(slots=True)
class ScanTopic:
    """Scans of one topic as far as the choice needs them.

    stamps   seconds
    returns  number of returns of each scan
    defect   why the lidar does not measure in one horizontal plane, as text; empty if it does, as far as is known
    """

    name: str
    defect: str = ""
    stamps: list[float] = field(default_factory=list)
    returns: list[int] = field(default_factory=list)

    def add(self, scan: Scan) -> None:
        """Add the next scan in the recording's order."""
        self.stamps.append(scan.stamp)
        self.returns.append(int(np.count_nonzero(~np.isnan(scan.ranges))))

    @property
    def even(self) -> NDArray[np.bool_]:
        """(n - 1,) true for each scan that follows the one before by a whole number of the topic's median period."""
        steps = np.diff(self.stamps)
        if not np.any(steps > 0.0):
            return np.zeros(len(steps), dtype=bool)
        periods = steps / np.median(steps[steps > 0.0])
        return np.asarray(np.abs(periods - np.maximum(np.round(periods), 1.0)) <= MAX_UNEVENNESS)

    @property
    def quality(self) -> float:
        """Number of returns of evenly stamped scans, times the share of these scans, since the others do harm.

        A further criterion that says which scans are good is one more mask here.
        """
        good = self.even
        return float(np.sum(np.array(self.returns[1:]), where=good) * np.mean(good)) if len(good) else 0.0

    def describe(self) -> str:
        """Return the properties that the choice is based on, as text."""
        even, returns = self.even, self.returns
        share = float(even.mean()) if len(even) else 0.0
        mean = float(np.mean(returns)) if returns else 0.0
        defect = f", {self.defect}" if self.defect else ""
        return f"{len(returns)} scans, {100.0 * share:.0f} % evenly stamped, with {mean:.0f} returns each{defect}"


def choose_scan_topic(topics: Sequence[ScanTopic]) -> tuple[str, str]:
    """Return the name of the topic of the best quality, one without a defect if any, and the reason as a line of text.

    topics  at least one; of equally good ones the first is chosen
    """
    chosen = max(topics, key=lambda topic: (not topic.defect, topic.quality))
    others = "; ".join(f"{topic.name}: {topic.describe()}" for topic in topics if topic is not chosen)
    return chosen.name, f"scans of {chosen.name}: {chosen.describe()} ({others}); lidar.topic names another topic"

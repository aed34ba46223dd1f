"""Steps of the timelines `candidate` and `closure`.

A step shows everything as it was right after a loop decision or a correction of the map. It is logged when the next
keyframe or decision begins, since a correction is followed by the corrected map.
"""

from __future__ import annotations

from .rrd_writer import RrdWriter
from .timelines import CANDIDATE, CLOSURE


class DecisionSteps:
    """Loop decisions and corrections of the map so far, each of which becomes a step.

    decisions    number of loop decisions
    corrections  number of those that corrected the map
    """

    def __init__(self, writer: RrdWriter) -> None:
        self._writer = writer
        self.decisions = self.corrections = 0
        self._logged_decisions = self._logged_corrections = 0

    def add(self, *, corrects: bool) -> None:
        """Begin the step of a decision, which `corrects` the map or not."""
        self.decisions += 1
        self.corrections += corrects

    @property
    def is_correction_open(self) -> bool:
        """True if the step of the last correction is not logged yet."""
        return self.corrections > self._logged_corrections

    def end(self) -> None:
        """Log the step of the last decision, and of the last correction, if it is not logged yet."""
        if self.decisions > self._logged_decisions:
            self._writer.log_step(CANDIDATE, self.decisions)
        if self.is_correction_open:
            self._writer.log_step(CLOSURE, self.corrections)
        self._logged_decisions, self._logged_corrections = self.decisions, self.corrections

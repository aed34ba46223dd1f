"""Probability that odometry fails from one scan to the next, learned while driving.

Without odometry the motion is predicted at constant velocity, and what fails is that the robot moves evenly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

# Scans and slips that count before any driving. Origin: chosen, one slip in twenty scans, as nothing is known of the
# robot; within some minutes of driving its own slips count more.
PRIOR_SCANS, PRIOR_SLIPS = 20, 1


@dataclass(slots=True)
class SlipStatistics:
    """Number of tracked scans, and of those before which odometry failed: it slipped, stood still or jumped."""

    scans: int = 0
    slips: int = 0

    def add(self, *, slipped: bool) -> None:
        """Count a tracked scan."""
        self.scans += 1
        self.slips += slipped

    @property
    def cost(self) -> float:
        """Minus the logarithm of the probability of a slip: the mean of its posterior, with a beta prior."""
        return math.log((PRIOR_SCANS + self.scans) / (PRIOR_SLIPS + self.slips))

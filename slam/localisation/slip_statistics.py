"""Probability that odometry fails from one scan to the next, learned while driving.

Failures come in a row: a robot that is pushed or carried moves for seconds while its wheels stand still. So odometry is
a Markov chain with two states, and the probability of a slip is learned for each: after a scan before which odometry
has measured the motion, and after a slip.

Without odometry the motion is predicted at constant velocity, and what fails is that the robot moves evenly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

# Scans and slips that count before any driving. Origin: chosen, one slip in twenty scans, as nothing is known of the
# robot; within some minutes of driving its own slips count more.
PRIOR_SCANS, PRIOR_SLIPS = 20, 1
# Scans after a slip, and slips among them, that count before any driving. Origin: definition, the uniform prior of a
# probability: that odometry keeps failing is as probable as that it does not.
PRIOR_SCANS_AFTER_SLIPS, PRIOR_REPEATED_SLIPS = 2, 1


@dataclass(slots=True)
class SlipStatistics:
    """Counts of tracked scans, and of slips: scans before which odometry slipped, stood still or jumped.

    scans           tracked scans
    slips           tracked scans before which odometry failed
    after_slips     tracked scans that follow a slip
    repeated_slips  slips that follow a slip
    failing         True if the last tracked scan was a slip
    """

    scans: int = 0
    slips: int = 0
    after_slips: int = 0
    repeated_slips: int = 0
    failing: bool = False

    def add(self, *, slipped: bool) -> None:
        """Count a tracked scan."""
        self.scans += 1
        self.slips += slipped
        if self.failing:
            self.after_slips += 1
            self.repeated_slips += slipped
        self.failing = slipped

    @property
    def cost(self) -> float:
        """Minus the logarithm of the probability of a slip before the next scan."""
        return -math.log(self._probability)

    @property
    def cost_of_none(self) -> float:
        """Minus the logarithm of the probability that odometry measures the motion to the next scan."""
        return -math.log1p(-self._probability)

    @property
    def _probability(self) -> float:
        """Probability of a slip in the present state: the mean of its posterior, with a beta prior."""
        if self.failing:
            return (PRIOR_REPEATED_SLIPS + self.repeated_slips) / (PRIOR_SCANS_AFTER_SLIPS + self.after_slips)
        first_slips = self.slips - self.repeated_slips
        return (PRIOR_SLIPS + first_slips) / (PRIOR_SCANS + self.scans - self.after_slips)

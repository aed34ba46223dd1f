"""Probability that odometry slips from one scan to the next, learned while driving.

Slips come in a row: a robot that is pushed or carried moves for seconds while its wheels stand still. So odometry is
a Markov chain with two states, and the probability of a slip is learned for each: after a scan before which odometry
has measured the motion, and after a slip.

Without odometry the motion is predicted at constant velocity, and a slip is a motion that is not even.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

# Scans and slips that count before any driving. Origin: chosen, one slip in twenty scans, as nothing is known of the
# robot; within some minutes of driving its own slips count more.
PRIOR_SCANS, PRIOR_SLIPS = 20, 1
# Scans after a slip, and slips among them, that count before any driving. Origin: definition, the uniform prior of a
# probability: that odometry keeps slipping is as probable as that it does not.
PRIOR_SCANS_AFTER_SLIPS, PRIOR_REPEATED_SLIPS = 2, 1


@dataclass(slots=True)
class SlipStatistics:
    """Counts of tracked scans, and of slips: scans before which odometry slipped, stood still or jumped.

    scans           tracked scans
    slips           tracked scans before which odometry slipped
    after_slips     tracked scans that follow a slip
    repeated_slips  slips that follow a slip
    after_slip      True if the last tracked scan was a slip, so that the next one follows a slip
    """

    scans: int = 0
    slips: int = 0
    after_slips: int = 0
    repeated_slips: int = 0
    after_slip: bool = False

    def add(self, *, slipped: bool) -> None:
        """Count a tracked scan."""
        self.scans += 1
        self.slips += slipped
        if self.after_slip:
            self.after_slips += 1
            self.repeated_slips += slipped
        self.after_slip = slipped

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
        if self.after_slip:
            return (PRIOR_REPEATED_SLIPS + self.repeated_slips) / (PRIOR_SCANS_AFTER_SLIPS + self.after_slips)
        first_slips = self.slips - self.repeated_slips
        return (PRIOR_SLIPS + first_slips) / (PRIOR_SCANS + self.scans - self.after_slips)

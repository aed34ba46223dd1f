"""When the beams of a scan were measured: as the recording states, or as a lidar that turns steadily measures them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..messages import Scan, with_reversed_times

BeamOrder = Literal["auto", "forward", "reversed"]


@dataclass(frozen=True, slots=True)
class BeamTimes:
    """Times of the beams within a sweep.

    turn      seconds in which the lidar turns once, so that the beams are measured one after the other by their
              angles; 0 if all are measured at once; None if their times are as stated
    reversed  if the beams are measured in the opposite of the stated order; with a turn, if clockwise
    """

    turn: float | None = None
    reversed: bool = False

    @property
    def as_stated(self) -> bool:
        """True if scans are not changed."""
        return self.turn is None and not self.reversed

    def of(self, scan: Scan) -> Scan:
        """Return a scan with these times."""
        if self.turn is not None and len(scan.angles):
            turned = (scan.angles - scan.angles[0]) / (2.0 * np.pi)
            scan = replace(scan, time_offsets=self.turn * turned)
        return with_reversed_times(scan) if self.reversed else scan


STATED = BeamTimes()


def set_beam_times(order: BeamOrder, turn: float | None) -> BeamTimes | None:
    """Return the times that a user has set; None if they are left to what is stated or found.

    order  of the beams; with "auto", a lidar whose turn is set turns counter-clockwise
    turn   seconds in which the lidar turns once, 0 if it measures all beams at once; None: as stated
    """
    return None if order == "auto" and turn is None else BeamTimes(turn, reversed=order == "reversed")

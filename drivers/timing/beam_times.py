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
    centred   if scans are stamped in the middle of the sweep. A format with one time for a scan, and none for beams,
              does not state if it is the time of the first beam, of the last one, or later. If all its beams are drawn
              as if they were measured at the stamp, such a scan fits best in the middle
    """

    turn: float | None = None
    reversed: bool = False
    centred: bool = False

    @property
    def as_stated(self) -> bool:
        """True if scans are not changed."""
        return self.turn is None and not self.reversed

    def of(self, scan: Scan) -> Scan:
        """Return a scan with these times; its stamp is that of the first beam."""
        if self.turn is not None and len(scan.angles):
            turned = (scan.angles - scan.angles[0]) / (2.0 * np.pi)
            scan = replace(scan, time_offsets=self.turn * turned)
            if self.centred:
                scan = replace(scan, stamp=scan.stamp - 0.5 * scan.duration)
        return with_reversed_times(scan) if self.reversed else scan

    @property
    def earlier(self) -> float:
        """Seconds by which the stamps of scans become earlier, at most."""
        return 0.5 * (self.turn or 0.0) if self.centred else 0.0


STATED = BeamTimes()


def set_beam_times(order: BeamOrder, turn: float | None) -> BeamTimes | None:
    """Return the times that a user has set; None if they are left to what is stated or found.

    order  of the beams; with "auto", a lidar whose turn is set turns counter-clockwise
    turn   seconds in which the lidar turns once, 0 if it measures all beams at once; None: as stated
    """
    return None if order == "auto" and turn is None else BeamTimes(turn, reversed=order == "reversed")

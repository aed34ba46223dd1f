"""Find the readings of a lidar that stand for a no-return.

Where no echo comes back, many lidars report a value near the upper end of their range instead of nothing, often not one
value but several close to each other. Real returns become rarer towards the longest ranges, so such values stand out: a
narrow band at the top of the histogram holds far more readings than the wider band below it. They come from beams in
many directions, while a far wall is seen in few.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.messages import Floats

# Width of the band at the top, as a share of the largest reading. Origin: measured, values that stand for a no-return
# scatter over 0.22 % (51.05 to 51.16 m) and 0.10 % (8.183 to 8.191 m) in recordings.
BAND = 0.003
# Lower end of the band below, as a share of the largest reading. Origin: chosen, thirty times as wide as the top band.
BELOW = 0.9
# Least ratio of the densities of readings in the two bands. Origin: chosen; of returns it is at most about one.
MIN_DENSITY_RATIO = 10.0
# Least number of scans with a reading in the top band. Origin: chosen; not measured.
MIN_SCANS = 3
# Parts of equal size into which the beams of a scan are divided. Origin: chosen; not measured.
BEAM_PARTS = 50
# Least share of these parts with a reading in the top band. Origin: geometry. A wall's ranges stay within BAND of its
# distance over 2 acos(1 - BAND) = 9 degrees, a tenth of the narrowest usual field of view, also if the robot stands.
MIN_SHARE_OF_PARTS = 0.2
# Scans of a recording that are examined. Origin: chosen, as many as for a lidar's mount; not measured.
MAX_SAMPLE = 200

Item = TypeVar("Item")


class SpreadSample(Generic[Item]):
    """At most MAX_SAMPLE items of a sequence of unknown length, spread evenly over it."""

    def __init__(self) -> None:
        self.items: list[Item] = []
        self._stride = 1
        self._count = 0

    def add(self, item: Item) -> None:
        """Add the next item of the sequence; every second one is dropped when the sample is full."""
        if self._count % self._stride == 0:
            if len(self.items) == MAX_SAMPLE:
                self.items = self.items[::2]
                self._stride *= 2
            self.items.append(item)
        self._count += 1


def find_no_return(readings: Sequence[Floats]) -> float | None:
    """Return the smallest reading that stands for a no-return, None if there is none.

    readings  of several scans spread over a drive, each (n,) in the order of the beams, in any unit; values that are
              not positive and finite are ignored, but must be there: a beam counts by its place in the scan
    """
    scans = [np.where(np.isfinite(scan) & (scan > 0.0), scan, 0.0) for scan in readings]
    largest = max((float(scan.max()) for scan in scans if len(scan)), default=0.0)
    low = (1.0 - BAND) * largest
    in_band = [np.flatnonzero(scan >= low) for scan in scans] if largest > 0.0 else []
    top = sum(len(beams) for beams in in_band)
    below = sum(int(np.count_nonzero((scan >= BELOW * largest) & (scan < low))) for scan in scans)
    density_ratio = top * (1.0 - BAND - BELOW) / (BAND * max(below, 1))
    if (
        density_ratio < MIN_DENSITY_RATIO
        or sum(len(beams) > 0 for beams in in_band) < MIN_SCANS
        or _share_of_parts(scans, in_band) < MIN_SHARE_OF_PARTS
    ):
        return None
    return min(float(scan[beams].min()) for scan, beams in zip(scans, in_band, strict=True) if len(beams))


def _share_of_parts(scans: Sequence[Floats], in_band: Sequence[NDArray[np.int64]]) -> float:
    """Return the share of the parts of the scans that contain one of the beams `in_band` of each scan, 0 to 1."""
    hit = np.zeros(BEAM_PARTS, dtype=bool)
    for scan, beams in zip(scans, in_band, strict=True):
        for beam in beams.tolist():  # a beam of a scan of few beams fills several parts
            first, end = BEAM_PARTS * beam // len(scan), BEAM_PARTS * (beam + 1) // len(scan)
            hit[first : max(first + 1, end)] = True
    return float(hit.mean())

"""Measure how well the scans of a drive agree with each other along a path, without a reference.

All beams are drawn into a grid from the poses that the path has at their times. A beam hits the cell in which it ends
and passes through those before. If the poses are right, nearly all beams that reach a cell hit it, or nearly none does;
doubled, displaced and blurred walls have cells that some beams hit and others pass through. Values depend on the
building and the lidar, so they compare paths of the same drive only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled
from drivers.messages import Scan

from ..geometry.segments import Floats
from ..io.tum import Trajectory

CELL = 0.05
"""Metres, side of a cell."""
END_CELLS = 3.0
"""Cells before a beam's end that it is not counted to pass through: walls are met at an angle, and ranges are noisy."""
MAX_RANGE = 30.0
"""Metres; longer ranges are not used."""
MIN_RANGE = 0.1
"""Metres; shorter ranges are not used: they are often parts of the robot."""
FULL_RANGE = 0.98
"""Share of the lidar's largest range from which on a range is not used."""
MAX_BEAMS = 360
"""Beams of a scan that are used at most."""
MAX_GAP = 0.5
"""Seconds between a scan and the nearest pose of the path beyond which the scan is not placed."""
MIN_REACHED = 3
"""Beams that must reach a cell for it to be counted."""
MAX_CELLS = 300_000_000
"""Cells of a grid; a path that needs more is absurd."""


@dataclass(frozen=True, slots=True)
class ScanAgreement:
    """Agreement of the scans of a drive along a path; NaN if no scan is placed, or if the grid would be too large.

    entropy   mean binary entropy of the share of hits of a cell, over all hits, bits; 0 is perfect
    conflict  share of all hits that are in cells which more beams pass through than hit
    placed    share of the scans within the path's time
    """

    entropy: float
    conflict: float
    placed: float


class BeamTable:
    """Beams of all scans of a drive that have a range, at most MAX_BEAMS of each scan.

    scans  number of scans
    """

    def __init__(self, scans: Iterable[Scan] = ()) -> None:
        self._stamps: list[float] = []
        self._columns: list[Floats] = []
        for scan in scans:
            self.add(scan)

    @property
    def scans(self) -> int:
        """Number of scans."""
        return len(self._stamps)

    def add(self, scan: Scan) -> None:
        """Add a scan."""
        every = max(1, len(scan.ranges) // MAX_BEAMS)
        ranges = scan.ranges[::every]
        used = (ranges > MIN_RANGE) & (ranges < min(MAX_RANGE, FULL_RANGE * scan.range_max))  # false for NaN
        ranges, angles = ranges[used], scan.angles[::every][used]
        mount = np.zeros(3) if scan.mount is None else scan.mount
        direction = angles + mount[2]
        ends = mount[:2] + ranges[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
        eyes = np.broadcast_to(mount[:2], ends.shape)
        number = np.full(len(ranges), float(len(self._stamps)))
        times = scan.stamp + scan.time_offsets[::every][used]
        self._stamps.append(scan.stamp)
        self._columns.append(np.column_stack([number, times, eyes, ends]))

    def agreement(self, path: Trajectory) -> ScanAgreement:
        """Return how well the scans agree if the base follows a path."""
        placed = self._placed(path)
        beams = np.concatenate(self._columns) if self._columns else np.zeros((0, 6))
        beams = beams[placed[beams[:, 0].astype(np.int64)]] if len(beams) else beams
        share = float(placed.mean()) if len(placed) else 0.0
        if not len(beams):
            return ScanAgreement(math.nan, math.nan, share)
        poses = path.at(beams[:, 1]).poses
        eyes, ends = (se2.transform(poses, beams[:, k : k + 2]) for k in (2, 4))
        origin = np.minimum(eyes.min(axis=0), ends.min(axis=0)) - CELL
        shape = np.ceil((np.maximum(eyes.max(axis=0), ends.max(axis=0)) - origin) / CELL).astype(np.int64) + 2
        if int(shape[0]) * int(shape[1]) > MAX_CELLS:
            return ScanAgreement(math.nan, math.nan, share)
        hits, passes = (np.zeros((shape[0], shape[1]), dtype=np.int32) for _ in range(2))
        _draw((eyes - origin) / CELL, (ends - origin) / CELL, hits, passes)
        return ScanAgreement(*_disagreement(hits, passes), share)

    def _placed(self, path: Trajectory) -> NDArray[np.bool_]:
        """Return (n,) True for the scans near a pose of the path."""
        stamps = np.array(self._stamps)
        if not len(stamps):
            return np.zeros(0, dtype=bool)
        return np.asarray(np.abs(path.stamps[path.nearest(stamps)] - stamps) <= MAX_GAP)


def _disagreement(hits: NDArray[np.int32], passes: NDArray[np.int32]) -> tuple[float, float]:
    """Return entropy and conflict of a grid."""
    counted = (hits > 0) & (hits + passes >= MIN_REACHED)
    hit = hits[counted].astype(np.float64)
    if not len(hit):
        return math.nan, math.nan
    share = hit / (hit + passes[counted])
    rest = 1.0 - share
    bits = -share * np.log2(share) - np.where(rest > 0.0, rest * np.log2(np.where(rest > 0.0, rest, 1.0)), 0.0)
    return float(np.average(bits, weights=hit)), float(hit[share < 0.5].sum() / hit.sum())


@compiled
def _draw(eyes: Floats, ends: Floats, hits: NDArray[np.int32], passes: NDArray[np.int32]) -> None:
    """Count, in place, the beams that hit each cell of a grid and those that pass through it.

    eyes, ends  (n, 2) of the beams, in cells from the grid's corner; all lie within the grid

    A beam passes through the cells of points on it that are one cell apart: cells of which it only cuts a corner are
    mostly left out.
    """
    for k in range(eyes.shape[0]):
        hits[int(ends[k, 0]), int(ends[k, 1])] += 1
        dx, dy = ends[k, 0] - eyes[k, 0], ends[k, 1] - eyes[k, 1]
        length = math.hypot(dx, dy)
        last_x, last_y = -1, -1
        for step in range(int(length - END_CELLS)):
            x, y = int(eyes[k, 0] + step * dx / length), int(eyes[k, 1] + step * dy / length)
            if x != last_x or y != last_y:
                passes[x, y] += 1
                last_x, last_y = x, y

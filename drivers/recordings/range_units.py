"""Recognise ranges in millimetres or centimetres, and find how many metres a unit of the readings is.

Ranges that are nearly all beyond FAR are no metres. Which unit they are in shows when the robot moves: the beam in the
direction of travel becomes shorter by the distance driven, the beam that points back becomes longer by it, whatever the
directions of the walls. The median of that ratio over a drive is the number of units in a metre. In recordings in
metres it is 0.90 to 1.11.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from .. import se2
from ..immutable import immutable
from ..messages import Floats
from ..se2 import Pose

FAR = 100.0
"""Metres. Origin: data sheets; 2-D lidars of robots reach less, but few ranges in millimetres are below 100."""
NEAR_SHARE = 0.1
"""Share of the readings that may be below FAR. Origin: chosen; a range in millimetres is rarely below 0.1 m."""
UNITS = {1000.0: "millimetres", 100.0: "centimetres"}
"""Units of ranges, by their number in a metre."""
TOLERANCE = 2.0
"""Factor between the measured ratio and a unit. Origin: chosen; units differ by factors of ten and more."""
MIN_STEP, MAX_STEP = 0.1, 2.0
"""Metres between two compared scans. Origin: chosen; well above the noise of ranges, and below the size of rooms."""
MIN_PAIRS = 10
"""Pairs of beams for a median that is certain. Origin: chosen; not measured."""


@immutable
class ScanInUnits:
    """Scan whose ranges are in an unknown unit.

    angles    (n,) of the beams in the lidar's frame, increasing, radians
    readings  (n,) ranges; values that are not positive and finite are no-returns
    pose      [x, y, heading] of the lidar by odometry, metres and radians
    """

    angles: Floats
    readings: Floats
    pose: Pose


class UnitReport(Protocol):
    """Receiver of what was found out about the ranges."""

    def interpret(self, text: str) -> None:
        """Report how the ranges are read."""

    def doubt(self, text: str) -> None:
        """Report that the ranges are probably wrong."""


def find_range_unit(sample: Sequence[Floats], drive: Iterable[ScanInUnits], report: UnitReport) -> float:
    """Return how many units of the ranges are in a metre; 1 if they are metres or their unit cannot be found.

    sample  readings of scans spread over the drive, each (n,)
    drive   all scans in order; only iterated if the sample shows that the ranges are not in metres
    """
    if are_metres(sample):
        return 1.0
    estimator = RangeUnitEstimator()
    for scan in drive:
        estimator.add(scan)
    per_metre = estimator.per_metre
    if per_metre is None:
        report.doubt(f"ranges are probably not in metres: nearly all are beyond {FAR:g}; their unit is unknown")
        return 1.0
    report.interpret(f"ranges in {UNITS[per_metre]}, converted to metres")
    return per_metre


def are_metres(readings: Sequence[Floats]) -> bool:
    """Return false if ranges cannot be metres because nearly all of them are beyond FAR.

    readings  each (n,); values that are not positive and finite are ignored
    """
    values = np.concatenate([np.zeros(0), *readings])
    values = values[np.isfinite(values) & (values > 0.0)]
    return not len(values) or float(np.mean(values <= FAR)) > NEAR_SHARE


class RangeUnitEstimator:
    """Estimator of the unit of ranges from the scans of a drive."""

    def __init__(self) -> None:
        self._reference: ScanInUnits | None = None
        self._ratios: list[float] = []

    def add(self, scan: ScanInUnits) -> None:
        """Add the next scan of the drive."""
        before = self._reference
        if before is None:
            self._reference = scan
            return
        x, y = scan.pose[:2] - before.pose[:2]
        distance = float(np.hypot(x, y))
        if distance < MIN_STEP:
            return
        self._reference = scan
        if distance > MAX_STEP:
            return
        travel = float(np.arctan2(y, x))
        for direction in (travel, travel + np.pi):
            change = _reading_at(direction, scan) - _reading_at(direction, before)
            if np.isfinite(change):
                self._ratios.append(abs(change) / distance)

    @property
    def per_metre(self) -> float | None:
        """Units in a metre, a key of UNITS; None if the scans do not show it."""
        if len(self._ratios) < MIN_PAIRS:
            return None
        ratio = float(np.median(self._ratios))
        return next((unit for unit in UNITS if unit / TOLERANCE <= ratio <= unit * TOLERANCE), None)


def _reading_at(direction: float, scan: ScanInUnits) -> float:
    """Return the reading of the beam nearest to a direction in the odometry's frame; NaN if there is no return."""
    if len(scan.angles) < 2:
        return np.nan
    offsets = np.abs(se2.wrap(scan.angles + scan.pose[2] - direction))
    nearest = int(np.argmin(offsets))
    valid = offsets[nearest] <= scan.angles[1] - scan.angles[0] and scan.readings[nearest] > 0.0
    return float(scan.readings[nearest]) if valid else np.nan

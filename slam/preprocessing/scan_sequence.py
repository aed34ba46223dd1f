"""All processed scans of a session, with little memory for those whose features were dropped."""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

from ..geometry.growing_array import GrowingArray
from ..geometry.segments import Floats
from ..matching.scan_features import ScanFeatures
from .packed_features import PackedFeatures
from .preprocessor import NO_FEATURES, ProcessedScan


class ScanSequence(Sequence[ProcessedScan]):
    """Processed scans in time order; a scan without features takes 40 bytes.

    Numbers are in arrays, as objects are eight times as large: a robot drives for days, mostly in familiar places,
    where the features of scans are dropped.
    """

    def __init__(self, scans: Iterable[ProcessedScan] = ()) -> None:
        self._stamps, self._odometry, self._travel = GrowingArray(()), GrowingArray((3,)), GrowingArray(())
        self._unmeasured: list[int] = []  # rows of the scans to which odometry does not lead, which are rare
        self._features: dict[int, PackedFeatures] = {}  # by row; the other scans have none
        for scan in scans:
            self.append(scan)

    @classmethod
    def of(cls, scans: Sequence[ProcessedScan]) -> ScanSequence:
        """Return the scans as a ScanSequence: themselves if they are one."""
        return scans if isinstance(scans, ScanSequence) else cls(scans)

    def copy(self) -> ScanSequence:
        """Return a copy that later scans do not change; it shares the numbers."""
        other = ScanSequence()
        other._stamps, other._odometry = self._stamps.copy(), self._odometry.copy()
        other._travel, other._unmeasured = self._travel.copy(), list(self._unmeasured)
        other._features = dict(self._features)
        return other

    def append(self, scan: ProcessedScan) -> None:
        """Append a scan."""
        if scan.features is not NO_FEATURES:
            self._features[len(self)] = PackedFeatures(scan.features)
        if not scan.measured:
            self._unmeasured.append(len(self))
        self._stamps.append(scan.stamp)
        self._odometry.append(scan.odometry)
        self._travel.append(scan.travel)

    def drop_features(self, rows: Iterable[int]) -> None:
        """Drop the features of some scans."""
        for row in rows:
            self._features.pop(row, None)

    def __len__(self) -> int:
        return len(self._stamps)

    @overload
    def __getitem__(self, row: int) -> ProcessedScan: ...

    @overload
    def __getitem__(self, row: slice) -> ScanSequence: ...

    def __getitem__(self, row: int | slice) -> ProcessedScan | ScanSequence:
        if isinstance(row, slice):
            return ScanSequence(self[k] for k in range(*row.indices(len(self))))
        row = range(len(self))[row]
        stamp, travel, measured = float(self.stamps[row]), float(self.travel[row]), self._is_measured(row)
        return ProcessedScan(stamp, self.odometry[row].copy(), self.features(row), travel, measured)

    @property
    def stamps(self) -> Floats:
        """(n,) seconds; not to be changed."""
        return self._stamps.rows

    @property
    def odometry(self) -> Floats:
        """(n, 3) odometry poses; not to be changed."""
        return self._odometry.rows

    @property
    def travel(self) -> Floats:
        """(n,) metres of wheel travel from the middle of the sweep to its ends; not to be changed."""
        return self._travel.rows

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(n,) True for scans to which odometry leads, see `ProcessedScan`."""
        mask = np.ones(len(self), dtype=bool)
        mask[self._unmeasured] = False
        return mask

    @property
    def has_features(self) -> NDArray[np.bool_]:
        """(n,) True for scans whose features are there."""
        mask = np.zeros(len(self), dtype=bool)
        mask[list(self._features)] = True
        return mask

    def features(self, row: int) -> ScanFeatures:
        """Return the features of a scan, NO_FEATURES if they are not there."""
        packed = self._features.get(row)
        return NO_FEATURES if packed is None else packed.unpack()

    def points(self, row: int) -> Floats:
        """Return the points (p, 2) of a scan in the base's frame, metres; none if its features are not there."""
        packed = self._features.get(row)
        return (NO_FEATURES if packed is None else packed).points.xy

    def _is_measured(self, row: int) -> bool:
        place = bisect.bisect_left(self._unmeasured, row)
        return self._unmeasured[place : place + 1] != [row]

"""Measurements cut into one `Scan` per revolution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..messages import Floats, Scan
from ..se2 import Pose
from .measurements import NO_QUALITY, Flags, Measurements, StructuredArray

MIN_SPAN = np.radians(300.0)
"""Radians that a complete revolution must span. Two lost capsules of an RPLIDAR leave a gap of 30 to 50 degrees."""
MAX_SPAN = np.radians(420.0)
"""Radians; a larger span means that the start of a revolution was lost."""
MAX_ANGLE_GAP = np.radians(60.0)
"""Radians between neighbouring beams of a complete revolution."""
MAX_TIME_GAP = 0.24
"""Maximum gap between measurements, as a share of the revolution's duration. If the start between two turns is lost
with more than half a turn, so that the angles alone look like one turn, the gap is more than a quarter.
"""
MAX_SAMPLES = 1 << 15
"""Samples of a revolution; an RPLIDAR with 32 000 per second that turns once a second has about as many."""


@dataclass(slots=True)
class RevolutionCounters:
    """Numbers of revolutions that became scans, of those with too large a loss or a lost start, and of stray points."""

    complete: int = 0
    incomplete: int = 0
    stray_points: int = 0


def make_scan(
    samples: StructuredArray,
    stamps: Floats,
    range_min: float,
    range_max: float,
    mount: Pose | None = None,
    upside_down: bool = False,
) -> Scan:
    """Return the scan of samples (n,) of SAMPLE in the order measured at `stamps` (n,) seconds; n >= 1.

    Angles are unwrapped from the first sample on, so that the beams are ordered by time, forwards or backwards, except
    where the device corrects its angles: clockwise they go from about 0 down to -2 pi. Of beams in the same direction,
    the first one with a return is kept. Ranges beyond the limits become NaN. `upside_down` mirrors the angles.
    """
    angles = np.unwrap(samples["angle"])
    if upside_down:
        angles = -angles
    ranges = np.where((samples["range"] >= range_min) & (samples["range"] <= range_max), samples["range"], np.nan)
    order = np.lexsort((np.isnan(ranges), angles))
    order = order[np.diff(angles[order], prepend=-np.inf) > 0.0]
    first = float(stamps[order].min())
    quality = samples["quality"][order].astype(np.float64)
    intensities = None if (quality == NO_QUALITY).all() else quality
    offsets = stamps[order] - first
    return Scan(first, ranges[order], angles[order], offsets, range_min, range_max, mount, intensities=intensities)


class RevolutionAssembler:
    """Assembly of measurements to scans.

    range_min, range_max, mount, upside_down  of the lidar, for the scans (see `make_scan`)
    whole_packets  if True, each packet is one scan, as with SCIP; otherwise a scan reaches from one start to the next,
                   and samples before the first start are discarded
    find_strays    returns which samples of a revolution are no surface; None: the lidar sends none
    """

    def __init__(
        self,
        range_min: float,
        range_max: float,
        mount: Pose | None = None,
        upside_down: bool = False,
        whole_packets: bool = False,
        find_strays: Callable[[StructuredArray], Flags] | None = None,
    ) -> None:
        self.range_min, self.range_max, self.mount, self.upside_down = range_min, range_max, mount, upside_down
        self.whole_packets, self._find_strays = whole_packets, find_strays
        self.counters = RevolutionCounters()
        self.reset()

    def reset(self) -> None:
        """Discard the unfinished revolution, because the lidar was started again."""
        self._samples: list[StructuredArray] = []
        self._stamps: list[Floats] = []
        self._has_start = False

    def add(self, measurements: Measurements, stamps: Floats) -> list[Scan]:
        """Return the scans completed by measurements (n,) with `stamps` (n,) in seconds on the host's clock."""
        samples = measurements.samples
        scans: list[Scan] = []
        starts = np.flatnonzero(samples["start"])
        for first, end in zip([0, *starts], [*starts, len(samples)], strict=True):
            if first < end and samples["start"][first]:
                scans += self._finish()
                self._has_start = True
            if self._has_start:
                self._samples.append(samples[first:end])
                self._stamps.append(stamps[first:end])
        if self.whole_packets:
            scans += self._finish()
        if sum(map(len, self._samples)) > MAX_SAMPLES:
            self.counters.incomplete += 1
            self.reset()
        return scans

    def _finish(self) -> list[Scan]:
        """Return the scan of the collected samples, if it is complete."""
        if not self._has_start:
            return []
        samples, stamps = np.concatenate(self._samples), np.concatenate(self._stamps)
        self.reset()
        if not self.whole_packets and not is_complete_revolution(samples, stamps):
            self.counters.incomplete += 1
            return []
        self.counters.complete += 1
        if self._find_strays is not None:
            stray = self._find_strays(samples)
            samples["range"][stray] = np.nan
            self.counters.stray_points += int(np.count_nonzero(stray))
        return [make_scan(samples, stamps, self.range_min, self.range_max, self.mount, self.upside_down)]


def is_complete_revolution(samples: StructuredArray, stamps: Floats) -> bool:
    """Return whether samples (n,) with `stamps` (n,) form one turn without too large a gap."""
    if len(samples) < 2:
        return False
    angles = np.sort(np.unwrap(samples["angle"]))
    span = angles[-1] - angles[0]
    if not MIN_SPAN <= span <= MAX_SPAN or np.diff(angles).max() > MAX_ANGLE_GAP:
        return False
    duration = stamps[-1] - stamps[0]
    return bool(duration > 0.0 and np.diff(stamps).max() <= MAX_TIME_GAP * duration)

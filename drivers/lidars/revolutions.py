"""Measurements cut into one `Scan` a revolution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..messages import Floats, Scan
from ..se2 import Pose
from .measurements import Measurements, StructuredArray

MIN_SPAN = np.radians(300.0)
"""What a revolution must span. Two lost capsules of an RPLIDAR leave 30 to 50 degrees out."""
MAX_SPAN = np.radians(420.0)
"""What no revolution spans: then the start of one was lost."""
MAX_ANGLE_GAP = np.radians(60.0)
"""Between neighbouring beams of a revolution that counts as complete."""
MAX_TIME_GAP = 0.24
"""Of a revolution's duration, between measurements. Where the start between two turns is lost with more than half a
turn, so that the angles alone look like one turn, it is more than a quarter.
"""
MAX_SAMPLES = 1 << 15
"""In a revolution; an RPLIDAR at 32 000 a second that turns once a second has about as many."""


@dataclass(slots=True)
class RevolutionCounters:
    """Revolutions that became scans, and those that did not: too much of them was lost, or their beginning."""

    complete: int = 0
    incomplete: int = 0


def make_scan(
    samples: StructuredArray,
    stamps: Floats,
    range_min: float,
    range_max: float,
    mount: Pose | None = None,
    upside_down: bool = False,
) -> Scan:
    """One scan of samples (n,) of SAMPLE in the order measured at `stamps` (n,) seconds; n >= 1.

    Angles are unwrapped from the first sample on, so that beams are in the order of time or against it, but for where
    the device corrects its angles: clockwise they go from about 0 down to -2 pi. Of beams in the same direction, the
    first that returned something is kept. Ranges beyond the limits are NaN. `upside_down` mirrors the angles.
    """
    angles = np.unwrap(samples["angle"])
    if upside_down:
        angles = -angles
    ranges = np.where((samples["range"] >= range_min) & (samples["range"] <= range_max), samples["range"], np.nan)
    order = np.lexsort((np.isnan(ranges), angles))
    order = order[np.diff(angles[order], prepend=-np.inf) > 0.0]
    first = float(stamps[order].min())
    return Scan(first, ranges[order], angles[order], stamps[order] - first, range_min, range_max, mount)


class RevolutionAssembler:
    """Takes measurements as they come, gives scans.

    range_min, range_max, mount, upside_down  of the lidar, for the scans (see `scan_of`)
    whole_packets  each packet is one scan, as with SCIP; otherwise a scan goes from one start to the next, and what
                   comes before the first start is left out
    """

    def __init__(
        self,
        range_min: float,
        range_max: float,
        mount: Pose | None = None,
        upside_down: bool = False,
        whole_packets: bool = False,
    ) -> None:
        self.range_min, self.range_max, self.mount, self.upside_down = range_min, range_max, mount, upside_down
        self.whole_packets = whole_packets
        self.counters = RevolutionCounters()
        self.reset()

    def reset(self) -> None:
        """Forget the revolution under way: the lidar was started again."""
        self._samples: list[StructuredArray] = []
        self._stamps: list[Floats] = []
        self._has_start = False

    def add(self, measurements: Measurements, stamps: Floats) -> list[Scan]:
        """The scans that measurements (n,) taken at `stamps` (n,), in seconds on the host's clock, complete."""
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
        """The scan of what was collected, if it is complete."""
        if not self._has_start:
            return []
        samples, stamps = np.concatenate(self._samples), np.concatenate(self._stamps)
        self.reset()
        if not self.whole_packets and not is_complete_revolution(samples, stamps):
            self.counters.incomplete += 1
            return []
        self.counters.complete += 1
        return [make_scan(samples, stamps, self.range_min, self.range_max, self.mount, self.upside_down)]


def is_complete_revolution(samples: StructuredArray, stamps: Floats) -> bool:
    """Whether samples (n,) taken at `stamps` (n,) go around once without too large a gap."""
    if len(samples) < 2:
        return False
    angles = np.sort(np.unwrap(samples["angle"]))
    span = angles[-1] - angles[0]
    if not MIN_SPAN <= span <= MAX_SPAN or np.diff(angles).max() > MAX_ANGLE_GAP:
        return False
    duration = stamps[-1] - stamps[0]
    return bool(duration > 0.0 and np.diff(stamps).max() <= MAX_TIME_GAP * duration)

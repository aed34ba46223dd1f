"""From messages to sightings: a scan waits until the odometry covers its sweep, is straightened, and condensed."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers import se2
from drivers.messages import Odometry, Scan
from features import Features

from ..config import Config
from ..geometry.segments import CornerPoints, Segments, corner_points, segments_from_lines
from ..matching.likelihood_field import MOST_POINTS, ScanPoints, thinned
from ..matching.line_matcher import ScanFeatures
from ..odometry.error_model import OdometryModel
from ..odometry.history import OdometryHistory
from .deskew import Sweep, deskew, loosen, mount_of
from .extraction import build_extractor

LONGEST_WAIT = 20  # scans that wait for the odometry to catch up before they are taken without


NO_FEATURES = ScanFeatures(
    Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2))),
    CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2))),
    ScanPoints(np.zeros((0, 2)), np.zeros((0, 2))),
)


@dataclass(frozen=True, slots=True, eq=False)
class ProcessedScan:
    """What one scan shows, in the base's frame, as if seen all at once at `stamp`, when odometry was at `odometry`."""

    stamp: float
    odometry: se2.Pose
    features: ScanFeatures

    def without_view(self) -> ProcessedScan:
        """That there was a scan; what it showed is not kept."""
        return replace(self, features=NO_FEATURES)


class Preprocessor:
    """Takes scans and odometry, gives sightings."""

    def __init__(self, config: Config, sigma_range: float | None = None) -> None:
        """`sigma_range` is a range's standard deviation, metres, where many scans have shown it already."""
        self._lidar = config.lidar
        self._extractor = build_extractor(config, sigma_range)
        self._waiting: deque[Scan] = deque()
        self.odometry = OdometryHistory()
        self.scans = 0
        self.empty_scans = 0
        self.scans_without_odometry = 0

    @property
    def sigma_range(self) -> float:
        """Standard deviation of a range as it is estimated now, metres."""
        return self._extractor.noise.sigma_range

    def add(self, message: Odometry | Scan) -> None:
        """Take a message."""
        if isinstance(message, Odometry):
            self.odometry.add(message)
            return
        self.scans += 1
        self.empty_scans += not np.isfinite(message.ranges).any()
        self._waiting.append(message)
        if not len(self.odometry) and len(self._waiting) > LONGEST_WAIT:
            self._waiting.popleft()
            self.scans_without_odometry += 1

    @property
    def waiting(self) -> list[Scan]:
        """The scans that wait for odometry; `wait` has them again."""
        return list(self._waiting)

    def wait(self, scans: Sequence[Scan]) -> None:
        """Let scans wait that waited before; they have been counted."""
        self._waiting.extend(scans)

    def next_scan(self, *, last: bool = False) -> Scan | None:
        """The oldest scan that waits, if odometry covers it or cannot be waited for: there are many, or no more comes
        (`last`)."""
        if not self._waiting or not len(self.odometry):
            return None
        covered = self._waiting[0].stamp + self._waiting[0].duration <= self.odometry.latest
        ready = covered or last or len(self._waiting) > LONGEST_WAIT
        return self._waiting.popleft() if ready else None

    def sight(self, scan: Scan, odometry_model: OdometryModel) -> ProcessedScan:
        """Straighten a scan and condense it into walls and corners, and points that are on neither."""
        mount = mount_of(scan, self._lidar)
        sweep = deskew(scan, self.odometry, mount, self._lidar.range_bias)
        features = self._extractor.extract(sweep.ranges, sweep.bearings)
        seen = _in_base_frame(sweep, features, mount, odometry_model)
        return ProcessedScan(sweep.stamp, sweep.odometry, seen)


def _in_base_frame(sweep: Sweep, features: Features, mount: se2.Pose, odometry_model: OdometryModel) -> ScanFeatures:
    """What a scan shows, moved from the lidar's frame into the base's."""
    segments = segments_from_lines(features.lines, mount)
    corners = corner_points(features.corners, segments, mount)
    segments, corners = loosen(segments, corners, features.lines, sweep, odometry_model)
    points = [thinned(se2.transform(mount, some), MOST_POINTS) for some in sweep.points(features.lines)]
    return ScanFeatures(segments, corners, ScanPoints(*points))

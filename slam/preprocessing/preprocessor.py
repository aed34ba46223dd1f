"""Turn messages into processed scans: wait for odometry, de-skew, extract features, transform into the base's frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers import se2
from drivers.messages import Odometry, Scan
from features import Features

from ..config import Config
from ..geometry.line_segments import corner_points, segments_from_lines
from ..geometry.segments import CornerPoints, Segments
from ..matching.line_matcher import ScanFeatures
from ..matching.scan_points import MAX_SCAN_POINTS, ScanPoints, rounded, subsample
from ..odometry.error_model import OdometryModel
from ..odometry.history import OdometryHistory
from .deskew import DeskewedScan, deskew, lidar_mount
from .extraction import build_extractor
from .motion_uncertainty import add_motion_uncertainty

# Scans in the queue above which the oldest is processed without odometry covering its sweep.
# Origin: chosen, two seconds at 10 Hz; not measured.
MAX_QUEUED_SCANS = 20

# Features of an empty scan. Origin: definition.
NO_FEATURES = ScanFeatures(
    Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2))),
    CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2))),
    ScanPoints(np.zeros((0, 2)), np.zeros((0, 2))),
)


@dataclass(frozen=True, slots=True, eq=False)
class ProcessedScan:
    """Features and points of one scan in the base's frame, corrected to the pose at `stamp`.

    stamp     seconds, the middle of the sweep
    odometry  (3,) odometry pose at `stamp`
    features  segments, corners and points in the base's frame
    travel    metres of wheel travel from the middle of the sweep to its ends
    """

    stamp: float
    odometry: se2.Pose
    features: ScanFeatures
    travel: float = 0.0

    def without_features(self) -> ProcessedScan:
        """Return the scan with its features dropped, to save memory."""
        return replace(self, features=NO_FEATURES)


class Preprocessor:
    """Queue of scans that wait for odometry, and the feature extraction."""

    def __init__(self, config: Config, sigma_range: float | None = None) -> None:
        """`sigma_range` is the standard deviation of a range (metres) if earlier scans have determined it."""
        self._lidar = config.lidar
        self._extractor = build_extractor(config, sigma_range)
        self._noise_settled = sigma_range is not None
        self._queue: deque[Scan] = deque()
        self.odometry = OdometryHistory()
        self.scans = 0
        self.empty_scans = 0
        self.scans_without_odometry = 0

    @property
    def sigma_range(self) -> float:
        """Current estimate of a range's standard deviation, metres."""
        return self._extractor.noise.sigma_range

    def add(self, message: Odometry | Scan) -> None:
        """Add a message. Scans before the first odometry are dropped once the queue is full."""
        if isinstance(message, Odometry):
            self.odometry.add(message)
            return
        self.scans += 1
        self.empty_scans += not np.isfinite(message.ranges).any()
        self._queue.append(message)
        if not len(self.odometry) and len(self._queue) > MAX_QUEUED_SCANS:
            self._queue.popleft()
            self.scans_without_odometry += 1

    @property
    def queued(self) -> list[Scan]:
        """Scans that wait for odometry."""
        return list(self._queue)

    def restore_queue(self, scans: Sequence[Scan]) -> None:
        """Append scans that were queued in an earlier run and counted there."""
        self._queue.extend(scans)

    def next_scan(self, *, flush: bool = False) -> Scan | None:
        """Remove and return the oldest scan if odometry covers its sweep; None otherwise.

        A scan is also returned if too many wait, or on `flush`, when no more odometry will come.
        """
        if not self._queue or not len(self.odometry):
            return None
        covered = self._queue[0].stamp + self._queue[0].duration <= self.odometry.latest
        ready = covered or flush or len(self._queue) > MAX_QUEUED_SCANS
        return self._queue.popleft() if ready else None

    def process(self, scan: Scan, odometry_model: OdometryModel) -> ProcessedScan:
        """De-skew a scan and extract its segments, corners and the points on neither."""
        mount = lidar_mount(scan, self._lidar)
        deskewed = deskew(scan, self.odometry, mount, self._lidar.range_bias, odometry_model)
        if not self._noise_settled:
            self._noise_settled = self._extractor.settle_noise(deskewed.ranges, deskewed.bearings)
        features = self._extractor.extract(deskewed.ranges, deskewed.bearings)
        in_base_frame = _to_base_frame(deskewed, features, mount, odometry_model)
        travel = float(deskewed.travel.max(initial=0.0))
        return ProcessedScan(deskewed.stamp, deskewed.odometry, in_base_frame, travel)


def _to_base_frame(
    scan: DeskewedScan, features: Features, mount: se2.Pose, odometry_model: OdometryModel
) -> ScanFeatures:
    """Transform the features of a scan from the lidar's frame into the base's."""
    segments = segments_from_lines(features.lines, mount)
    corners = corner_points(features.corners, segments, mount)
    segments, corners = add_motion_uncertainty(segments, corners, features.lines, scan, odometry_model)
    points = [rounded(subsample(se2.transform(mount, some), MAX_SCAN_POINTS)) for some in scan.points(features.lines)]
    return ScanFeatures(segments, corners, ScanPoints(*points))

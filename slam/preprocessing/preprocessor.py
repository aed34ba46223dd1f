"""Turn messages into processed scans: wait for odometry, de-skew, extract features, transform into the base's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Odometry, Scan
from features import LearnedNoise

from ..config import Config
from ..geometry.segments import CornerPoints, Segments
from ..mapping.trajectory_builder import SAME_STAMP
from ..matching.scan_features import ScanFeatures
from ..matching.scan_points import ScanPoints
from ..odometry.error_model import OdometryModel
from ..odometry.history import OdometryHistory
from ..odometry.measurement_clock import USUAL_PERIOD
from ..odometry.velocity import VelocityFilter
from .deskew import sweep_middle
from .lidar_features import LidarFeatures, joined
from .scan_queue import ScanPair, ScanQueue

# Features of an empty scan. Origin: definition.
NO_FEATURES = ScanFeatures(
    Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2))),
    CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2))),
    ScanPoints(np.zeros((0, 2))),
)


@immutable
class ProcessedScan:
    """Features and points of one scan in the base's frame, corrected to the pose at `stamp`.

    With two lidars it has the features of a scan of either.

    stamp     seconds, the middle of the sweep; later than that of the scan before
    odometry  (3,) odometry pose in the middle of the sweep
    features  segments, corners and points in the base's frame
    travel    metres of wheel travel from the middle of the sweep to its ends
    measured  False if odometry was missing or failing, so that an even motion is assumed to have led to the scan
    """

    stamp: float
    odometry: se2.Pose
    features: ScanFeatures
    travel: float = 0.0
    measured: bool = True

    @property
    def reading(self) -> Odometry:
        """Reading of odometry at the stamp."""
        return Odometry(self.stamp, self.odometry)


class Preprocessor:
    """Queue of scans that wait for odometry, and the feature extraction."""

    def __init__(
        self, config: Config, noise: LearnedNoise | None = None, second_noise: LearnedNoise | None = None
    ) -> None:
        """`noise` is that of a ray if earlier scans have determined it, `second_noise` that of the second lidar."""
        self._first = LidarFeatures(config.lidar, config.features, noise)
        self._second = LidarFeatures(config.second_lidar, config.features, second_noise)
        self._second_is_known = second_noise is not None
        self._predicts_odometry = config.odometry.source == "none"
        self._queue = ScanQueue(two_lidars=bool(config.second_lidar.topic), predicts_odometry=self._predicts_odometry)
        self._latest = -np.inf  # stamp of the last processed scan
        self.odometry = OdometryHistory()
        self.scans = 0
        self.second_scans = 0
        self.joined_scans = 0
        self.empty_scans = 0
        self.scans_without_odometry = 0

    @property
    def noise(self) -> LearnedNoise:
        """Current estimate of the noise of a ray; of the first lidar if there are two."""
        return self._first.noise

    @property
    def second_noise(self) -> LearnedNoise | None:
        """The same of the second lidar; None if there is none."""
        return self._second.noise if self.joined_scans or self._second_is_known else None

    @property
    def mounts(self) -> list[se2.Pose]:
        """Mount [x, y, heading] on the base of each lidar that was used, by number."""
        return [lidar.mount for lidar in (self._first, self._second) if lidar.mount is not None]

    def add(self, message: Odometry | Scan) -> None:
        """Add a message. Scans before the first odometry are dropped once the queue is full."""
        if isinstance(message, Odometry):
            self.odometry.add(message)
            return
        message = _within_stated_limits(message)
        self._queue.add(message)
        if message.lidar:
            self.second_scans += 1
            return
        self.scans += 1
        self.empty_scans += not np.isfinite(message.ranges).any()
        if not len(self.odometry) and self._queue.is_full:
            self._queue.drop_oldest()
            self.scans_without_odometry += 1

    @property
    def queued(self) -> list[Scan]:
        """Scans that wait for odometry."""
        return self._queue.scans

    def restore_queue(self, scans: Sequence[Scan]) -> None:
        """Append scans that were queued in an earlier run and counted there."""
        for scan in scans:
            self._queue.add(scan)

    def next_scan(self, *, flush: bool = False) -> ScanPair | None:
        """Remove and return the oldest scan if odometry covers its sweep; None otherwise.

        With it is the scan of a second lidar that is joined with it. A scan is also returned if too many wait, or on
        `flush`, when no more odometry will come. Scans from before the first odometry wait for its first readings,
        which show how the robot moved: a base may have booted while the robot was moving.
        """
        odometry, queue = self.odometry, self._queue
        if queue.is_empty or not len(odometry):  # as after most messages
            return None
        if queue.earliest < odometry.earliest and not self._predicts_odometry:
            if not flush and not queue.is_full and odometry.latest < odometry.earliest + USUAL_PERIOD:
                return None
            odometry.extend_back(queue.earliest)
        return queue.take(odometry.latest, flush=flush)

    def is_measured(self, pair: ScanPair) -> bool:
        """Return True if odometry measures the motion of the base during the first sweep, or begins later."""
        return pair.first.stamp <= self.odometry.latest

    def process(
        self, pair: ScanPair, odometry_model: OdometryModel, velocity: VelocityFilter | None = None
    ) -> ProcessedScan:
        """De-skew a scan and extract its segments, its corners and its points, also those on segments.

        Those of a second lidar's scan are added, moved to the stamp of the first. Stamps may be coarser than the scans
        are frequent: a scan with the stamp of the one before gets a stamp that is SAME_STAMP later.

        velocity  of the base during the sweeps; None if odometry measures the motion
        """
        odometry = self.odometry if velocity is None else self._even_motion(pair, velocity)
        first = self._first.extract(pair.first, odometry, odometry_model)
        features, deskewed = first.in_base_frame(odometry_model), first.deskewed
        travel = deskewed.motion.reach
        if pair.second is not None:
            second = self._second.extract(pair.second, odometry, odometry_model)
            features = joined(features, second.moved_to(deskewed, odometry_model).in_base_frame(odometry_model))
            self.joined_scans += 1
        self._latest = max(deskewed.stamp, self._latest + SAME_STAMP)
        return ProcessedScan(self._latest, deskewed.odometry, features, travel, velocity is None)

    def _even_motion(self, pair: ScanPair, velocity: VelocityFilter) -> OdometryHistory:
        """Return readings of a robot that moves evenly during the sweeps, from the pose of odometry in the middle."""
        middle = sweep_middle(pair.first)
        scans = [scan for scan in pair if scan is not None]
        begin, end = min(scan.stamp for scan in scans), max(scan.stamp + scan.duration for scan in scans)
        stamps = np.unique([begin, middle, end])
        return OdometryHistory.from_arrays(
            stamps,
            np.array([se2.compose(self.odometry.at(middle), velocity.motion(stamp - middle)) for stamp in stamps]),
        )


def _within_stated_limits(scan: Scan) -> Scan:
    """Return a scan with NaN in place of the readings that are not within the limits that its sensor states.

    Drivers report a no-return as the greatest range, or as a number beyond it.
    """
    outside = (scan.ranges < scan.range_min) | (scan.ranges >= scan.range_max)  # false for NaN
    return replace(scan, ranges=np.where(outside, np.nan, scan.ranges)) if outside.any() else scan

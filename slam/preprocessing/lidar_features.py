"""Features of the scans of one lidar in the base's frame, and those of two lidars joined."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.compiled import compiled
from drivers.immutable import immutable
from drivers.messages import Scan
from features import Features, LearnedNoise

from ..bounds import MAX_RANGE
from ..config import FeatureConfig, LidarConfig
from ..geometry.line_segments import corner_points, segments_from_lines
from ..geometry.segments import CornerPoints, Segments
from ..matching.scan_features import ScanFeatures
from ..matching.scan_points import MAX_SCAN_POINTS, ScanPoints
from ..odometry.error_model import OdometryModel
from ..odometry.history import OdometryHistory, wheel_travel
from .deskew import DeskewedScan, deskew, lidar_mount
from .extraction import build_extractor
from .motion_uncertainty import add_motion_uncertainty, displaced


@immutable
class ExtractedScan:
    """De-skewed scan with its features in the lidar's frame, and the lidar's mount."""

    deskewed: DeskewedScan
    features: Features
    mount: se2.Pose

    def in_base_frame(self, model: OdometryModel) -> ScanFeatures:
        """Return the features in the base's frame at the scan's stamp."""
        lines, mount = self.features.lines, self.mount
        segments = segments_from_lines(lines, mount)
        corners = corner_points(self.features.corners, segments, mount)
        segments, corners, sweep_covariance = add_motion_uncertainty(
            segments, corners, lines, self.deskewed, model, self.features.noise, mount
        )
        points = _points(self.deskewed, mount, self.features.noise.sigma_range)
        return ScanFeatures(segments, corners, points, sweep_covariance)

    def moved_to(self, reference: DeskewedScan, model: OdometryModel) -> ExtractedScan:
        """Return the scan as if it belonged to the stamp of another one; odometry says how the base has moved.

        The uncertainty of that motion is part of that of the sweep.
        """
        motion = model.correct(se2.between(reference.odometry, self.deskewed.odometry))
        sweep = replace(self.deskewed.motion, offset=float(wheel_travel(motion)))
        deskewed = replace(self.deskewed, stamp=reference.stamp, odometry=reference.odometry, motion=sweep)
        return replace(self, deskewed=deskewed, mount=se2.compose(motion, self.mount))


class LidarFeatures:
    """Feature extraction for the scans of one lidar, with its mount and its noise."""

    def __init__(self, lidar: LidarConfig, features: FeatureConfig, noise: LearnedNoise | None = None) -> None:
        """`noise` is that of a ray if earlier scans have determined it."""
        self.mount: se2.Pose | None = None
        """Mount [x, y, heading] of the lidar at its last scan; None before the first."""
        self._lidar = lidar
        self._extractor = build_extractor(lidar, features, noise)
        self._noise_settled = noise is not None

    @property
    def noise(self) -> LearnedNoise:
        """Current estimate of the noise of a ray."""
        return self._extractor.noise

    def extract(self, scan: Scan, odometry: OdometryHistory, model: OdometryModel) -> ExtractedScan:
        """De-skew a scan and extract its features."""
        self.mount = mount = lidar_mount(scan, self._lidar)
        deskewed = self._within_limits(deskew(scan, odometry, mount, self._lidar.range_bias, model))
        if not self._noise_settled:
            self._noise_settled = self._extractor.settle_noise(deskewed.ranges, deskewed.bearings)
        features = self._extractor.extract(deskewed.ranges, deskewed.bearings)
        return ExtractedScan(deskewed, features.without_chords(), mount)

    def _within_limits(self, scan: DeskewedScan) -> DeskewedScan:
        """Return a scan without the ranges that the settings exclude."""
        limit = min(self._lidar.range_max, MAX_RANGE)
        usable = (scan.ranges >= self._lidar.range_min) & (scan.ranges <= limit)  # false for NaN
        return replace(scan, ranges=np.where(usable, scan.ranges, np.nan))


def _points(scan: DeskewedScan, mount: se2.Pose, sigma: float) -> ScanPoints:
    """Return the valid returns of a scan in the base's frame; of many, every k-th, see MAX_SCAN_POINTS.

    sigma  of a range, see `ScanPoints`
    """
    cosines, sines = np.cos(scan.bearings), np.sin(scan.bearings)
    return ScanPoints(_placed(scan.ranges, cosines, sines, tuple(mount.tolist())), sigma)


@compiled
def _placed(ranges, cosines, sines, mount):  # type: ignore[no-untyped-def]
    """Return the points (p, 2) of every k-th valid return in the base's frame, MAX_SCAN_POINTS at most.

    ranges, cosines, sines  (n,) of the beams, and those of their bearings
    mount                   three numbers, of the lidar in the base's frame
    """
    valid = np.isfinite(ranges)
    step = max(1, -(-valid.sum() // MAX_SCAN_POINTS))
    points, found = np.empty((len(ranges), 2)), 0
    c, s = math.cos(mount[2]), math.sin(mount[2])
    for k in range(len(ranges)):
        if valid[k]:
            if found % step == 0:
                x, y = ranges[k] * cosines[k], ranges[k] * sines[k]
                points[found // step, 0] = mount[0] + c * x - s * y
                points[found // step, 1] = mount[1] + s * x + c * y
            found += 1
    return points[: -(-found // step)]


def joined(first: ScanFeatures, second: ScanFeatures) -> ScanFeatures:
    """Return the features of two lidars at the same stamp as those of one scan, the first lidar's first.

    The pose is that of the first scan: the second one counts with the displacements of both.
    """
    others, other_corners = displaced(second.segments, second.corners, first.sweep_covariance + second.sweep_covariance)
    segments = Segments(
        np.concatenate([first.segments.frame, others.frame]),
        np.concatenate([first.segments.half_length, others.half_length]),
        np.concatenate([first.segments.covariance, others.covariance]),
        np.concatenate([first.segments.bias_slope, others.bias_slope]),
    )
    corners = CornerPoints(
        np.concatenate([first.corners.position, other_corners.position]),
        np.concatenate([first.corners.covariance, other_corners.covariance]),
        np.concatenate([first.corners.segments, other_corners.segments + len(first.segments)]),
        np.concatenate([first.corners.headings, other_corners.headings]),
    )
    points, sigma = np.concatenate([first.points.xy, second.points.xy]), max(first.points.sigma, second.points.sigma)
    return ScanFeatures(segments, corners, ScanPoints(points, sigma), first.sweep_covariance)

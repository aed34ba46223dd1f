"""Features of one lidar, and of two, which are those of one scan at the pose of the first lidar's."""

from __future__ import annotations

import numpy as np

from drivers.messages import Odometry, Scan
from slam.config import FeatureConfig, LidarConfig, OdometryConfig
from slam.geometry.segments import CornerPoints, Segments
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import POINT_UNIT, ScanPoints
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import OdometryHistory
from slam.preprocessing.extraction import build_extractor
from slam.preprocessing.lidar_features import LidarFeatures, joined
from slam.preprocessing.motion_uncertainty import displaced

NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))


def scan_of(wall: list[float], sweep: list[float]) -> ScanFeatures:
    """Return a scan with a wall at a frame, and the standard deviations of its displacement."""
    segments = Segments(np.array([wall]), np.ones(1), np.array([1e-4 * np.eye(2)]))
    return ScanFeatures(segments, NO_CORNERS, ScanPoints(np.zeros((0, 2))), np.diag(sweep) ** 2)


def test_the_second_lidars_features_contain_the_displacements_of_both_scans() -> None:
    first = scan_of([2.0, 0.0, np.pi / 2], [0.01, 0.02, 0.003])
    second = scan_of([-3.0, 1.0, np.pi / 2], [0.02, 0.01, 0.001])
    both = joined(first, second)
    np.testing.assert_array_equal(both.segments.covariance[0], first.segments.covariance[0])
    np.testing.assert_array_equal(both.sweep_covariance, first.sweep_covariance)
    expected, _ = displaced(second.segments, second.corners, first.sweep_covariance + second.sweep_covariance)
    np.testing.assert_allclose(both.segments.covariance[1], expected.covariance[0])
    np.testing.assert_allclose(np.diag(both.segments.covariance[1]), [1e-4 + 5e-4 + 1e-5, 1e-4 + 1e-5])


def test_chords_of_curved_surfaces_are_no_segments() -> None:
    """A round room with one flat wall, 2 m in front of the lidar."""
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    noise = 0.01 * np.random.default_rng(1).normal(size=720)
    ranges = np.minimum(3.0, 2.0 / np.maximum(np.cos(angles), 0.01)) + noise
    model, history = OdometryModel(OdometryConfig()), OdometryHistory()
    for stamp in (0.0, 0.1, 0.2):
        history.add(Odometry(stamp, np.zeros(3)))
    scan = Scan(0.1, ranges, angles, np.zeros(720), 0.1, 10.0)
    lidar = LidarConfig(sigma_range=0.01)
    every_line = build_extractor(lidar, FeatureConfig()).extract(ranges, angles).lines
    features = LidarFeatures(lidar, FeatureConfig()).extract(scan, history, model).in_base_frame(model)
    assert len(every_line) > 15
    assert len(features.segments) < 0.4 * len(every_line)
    assert np.abs(features.segments.frame[:, 0] - 2.0).min() < 0.02
    assert len(features.points.xy) > 300


def test_ranges_outside_of_the_configured_limits_are_used_for_nothing() -> None:
    """A square room, with parts of the robot 0.15 m from the lidar."""
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    ranges = 2.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    ranges[50:70] = 0.15
    model, history = OdometryModel(OdometryConfig()), OdometryHistory()
    for stamp in (0.0, 0.1, 0.2):
        history.add(Odometry(stamp, np.zeros(3)))
    lidar = LidarConfig(range_min=0.2, range_max=2.4)
    extractor = LidarFeatures(lidar, FeatureConfig())
    scan = Scan(0.1, ranges, angles, np.zeros(360), 0.1, 10.0)
    features = extractor.extract(scan, history, model).in_base_frame(model)
    distances = np.hypot(*features.points.xy.T)
    assert np.count_nonzero((ranges >= 0.2) & (ranges <= 2.4)) == len(distances) > 200
    assert distances.min() > 0.2
    assert distances.max() < 2.4 + POINT_UNIT
    ends = np.hypot(features.segments.frame[:, 0], features.segments.frame[:, 1]) + features.segments.half_length
    assert len(features.segments) == 4
    assert ends.max() < 4.0

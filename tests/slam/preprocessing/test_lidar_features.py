"""Features of two lidars are those of one scan at the pose of the first lidar's."""

from __future__ import annotations

import numpy as np

from slam.geometry.segments import CornerPoints, Segments
from slam.matching.line_matcher import ScanFeatures
from slam.matching.scan_points import ScanPoints
from slam.preprocessing.lidar_features import joined
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

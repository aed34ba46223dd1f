"""Features of a scan without a range bias."""

import numpy as np

from drivers import se2
from slam.geometry.segments import CornerPoints, Segments
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import ScanPoints

COUNT = 40
"""Number of segments of the scan."""


def random_features() -> ScanFeatures:
    """Return segments around the lidar with random bias slopes, their corners, and points."""
    random = np.random.default_rng(0)
    bearing, distance = random.uniform(-np.pi, np.pi, COUNT), random.uniform(0.5, 8.0, COUNT)
    centre = distance[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    frames = np.column_stack([centre, se2.wrap(bearing + np.pi / 2 + random.uniform(-1.2, 1.2, COUNT))])
    slopes = random.normal(scale=[1.0, 0.3], size=(COUNT, 2))
    segments = Segments(frames, random.uniform(0.15, 3.0, COUNT), np.zeros((COUNT, 2, 2)), slopes)
    pairs = np.column_stack([np.arange(COUNT), (np.arange(COUNT) + 1) % COUNT])
    pairs = pairs[np.abs(np.sin(frames[pairs[:, 0], 2] - frames[pairs[:, 1], 2])) > 0.3]
    normals = np.stack([-np.sin(frames[pairs, 2]), np.cos(frames[pairs, 2])], axis=-1)
    positions = np.linalg.solve(normals, np.sum(normals * frames[pairs, :2], axis=-1)[..., None])[..., 0]
    corners = CornerPoints(positions, np.zeros((len(pairs), 2, 2)), pairs, frames[pairs, 2])
    return ScanFeatures(segments, corners, ScanPoints(centre))


def test_without_the_range_bias_segments_move_by_their_slopes_and_points_stay() -> None:
    scan, bias = random_features(), 1e-4
    moved = scan.without_range_bias(bias)
    shifts = np.column_stack([np.zeros(COUNT), -bias * scan.segments.bias_slope])
    np.testing.assert_allclose(moved.segments.frame, se2.compose(scan.segments.frame, shifts), atol=1e-12)
    assert moved.points is scan.points


def test_without_the_range_bias_corners_are_still_on_their_walls() -> None:
    scan, bias = random_features(), 1e-4
    moved = scan.without_range_bias(bias)
    pairs, positions = scan.corners.segments, scan.corners.position
    frames = moved.segments.frame[pairs]
    np.testing.assert_array_equal(moved.corners.headings, frames[..., 2])
    on_walls = np.stack([se2.transform(se2.inverse(frames[:, k]), moved.corners.position) for k in (0, 1)])
    distances = np.hypot(*(positions - scan.segments.frame[pairs[:, 0], :2]).T)
    assert (np.abs(on_walls[..., 1]) < 10.0 * bias**2 * (1.0 + distances)).all()
    assert np.hypot(*(moved.corners.position - positions).T).max() > bias


def test_without_a_range_bias_of_zero_the_features_are_the_same() -> None:
    scan = random_features()
    assert scan.without_range_bias(0.0) is scan

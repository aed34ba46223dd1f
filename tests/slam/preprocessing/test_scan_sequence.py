"""Processed scans of a session: they are returned as they were added, and need little memory without features."""

from dataclasses import fields

import numpy as np
import pytest

from slam.geometry.segments import CornerPoints, Segments
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import ScanPoints
from slam.preprocessing.preprocessor import NO_FEATURES, ProcessedScan
from slam.preprocessing.scan_sequence import ScanSequence

from ...traced_memory import traced_memory


def features(segments: int = 3, corners: int = 2, points: int = 5) -> ScanFeatures:
    """Return features of which no two numbers are the same."""
    random = np.random.default_rng(segments)
    return ScanFeatures(
        Segments(*(random.normal(size=(segments, *shape)) for shape in ((3,), (), (2, 2), (2,)))),
        CornerPoints(
            random.normal(size=(corners, 2)),
            random.normal(size=(corners, 2, 2)),
            random.integers(0, max(segments, 1), (corners, 2)),
            random.normal(size=(corners, 2)),
        ),
        ScanPoints(random.normal(size=(points, 2)), 0.01),
        random.normal(size=(3, 3)),
    )


def some_scans(count: int) -> list[ProcessedScan]:
    """Return scans of which every other one has features."""
    return [
        ProcessedScan(
            0.1 * k,
            np.array([k, -k, 0.01 * k]),
            NO_FEATURES if k % 2 else features(k, k // 2),
            0.001 * k,
            measured=k % 3 > 0,
        )
        for k in range(count)
    ]


def assert_equal(scan: ProcessedScan, expected: ProcessedScan) -> None:
    assert (scan.stamp, scan.travel, scan.measured) == (expected.stamp, expected.travel, expected.measured)
    np.testing.assert_array_equal(scan.odometry, expected.odometry)
    assert (scan.features is NO_FEATURES) == (expected.features is NO_FEATURES)
    assert scan.features.points is expected.features.points
    np.testing.assert_array_equal(scan.features.sweep_covariance, expected.features.sweep_covariance)
    for found, added in (
        (scan.features.segments, expected.features.segments),
        (scan.features.corners, expected.features.corners),
    ):
        for field in fields(added):
            values, original = getattr(found, field.name), getattr(added, field.name)
            assert values.dtype == original.dtype
            np.testing.assert_array_equal(values, original)


def test_scans_are_returned_as_they_were_added() -> None:
    scans = some_scans(5)
    sequence = ScanSequence(scans)
    assert len(sequence) == 5
    for scan, expected in zip(sequence, scans, strict=True):
        assert_equal(scan, expected)
    assert_equal(sequence[-1], scans[-1])
    for scan, expected in zip(sequence[1:4], scans[1:4], strict=True):
        assert_equal(scan, expected)
    with pytest.raises(IndexError):
        sequence[5]


def test_arrays_are_those_of_the_scans() -> None:
    scans = some_scans(6)
    sequence = ScanSequence.of(scans)
    assert ScanSequence.of(sequence) is sequence
    np.testing.assert_array_equal(sequence.stamps, [scan.stamp for scan in scans])
    np.testing.assert_array_equal(sequence.odometry, [scan.odometry for scan in scans])
    np.testing.assert_array_equal(sequence.travel, [scan.travel for scan in scans])
    np.testing.assert_array_equal(sequence.has_features, [True, False] * 3)
    assert ScanSequence().odometry.shape == (0, 3)


def test_dropped_features_are_gone_and_a_copy_keeps_them() -> None:
    scans = some_scans(4)
    sequence = ScanSequence(scans)
    copy = sequence.copy()
    sequence.drop_features([0, 1])
    sequence.append(scans[0])
    assert sequence[0].features is sequence.features(1) is NO_FEATURES
    assert sequence.has_features.tolist() == [False, False, True, False, True]
    assert copy.has_features.tolist() == [True, False, True, False]
    assert len(copy) == 4


def test_a_copy_takes_no_memory_for_scans_without_features() -> None:
    """Each save of a live run copies them, which are more the longer the robot drives."""
    sequence = ScanSequence([ProcessedScan(1.0, np.zeros(3), NO_FEATURES, 0.0)] * 10_000)
    with traced_memory() as memory:
        copy = sequence.copy()
    assert memory.peak < 0.05 * copy.odometry.nbytes


def test_a_scan_without_features_takes_five_numbers() -> None:
    scan = ProcessedScan(1.0, np.zeros(3), NO_FEATURES, 0.0)
    with traced_memory() as memory:
        sequence = ScanSequence()
        for _ in range(10_000):
            sequence.append(scan)
    assert memory.kept < 10_000 * 5 * 8 * 1.2


def test_features_take_little_more_than_their_numbers() -> None:
    """All scans of a drive are kept, with a handful of segments and corners each."""
    scans = [ProcessedScan(1.0, np.zeros(3), features(), 0.0) for _ in range(1000)]
    numbers = 3 * 10 + 2 * 10 + 9
    with traced_memory() as memory:
        sequence = ScanSequence(scans)
    assert memory.kept - 1000 * 5 * 8 < 1000 * (8 * numbers + 350)
    assert sequence.has_features.all()

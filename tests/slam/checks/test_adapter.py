"""The results of a run as arrays for the checks."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drivers import se2
from slam.checks.adapter import contradicted_places, drive_of, unconnected_parts
from slam.config import Config
from slam.mapping.odometry_segments import OdometrySegments
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import OdometryHistory
from slam.preprocessing.preprocessor import NO_FEATURES, ProcessedScan
from slam.preprocessing.scan_sequence import ScanSequence


def scans(count: int) -> list[ProcessedScan]:
    return [ProcessedScan(0.5 * k, np.array([0.3 * k, 0.1 * k, 0.2 * k]), NO_FEATURES) for k in range(count)]


def segments(*starts: int) -> OdometrySegments:
    return OdometrySegments(starts=starts)


def learned_model() -> OdometryModel:
    """Return a model of wheels that measure 10 % too much."""
    model = OdometryModel(Config().odometry)
    for _ in range(200):
        model.add_motion(np.array([0.44, 0.0, 0.0]), np.array([0.4, 0.0, 0.0]), 1e8 * np.eye(3))
    return model


def test_scans_without_a_pose_are_left_out_and_segments_are_kept_apart() -> None:
    poses = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    drive = drive_of(
        scans(5), segments(0, 3), (np.array([0.5, 1.0, 2.0]), poses), OdometryModel(Config().odometry), 0.0
    )
    assert drive.stamps.tolist() == [0.5, 1.0, 2.0]
    assert drive.poses.tolist() == poses.tolist()
    assert drive.segment.tolist() == [1, 1, 2]


def test_each_motion_of_odometry_is_corrected() -> None:
    given, model = scans(6), learned_model()
    stamps = np.array([scan.stamp for scan in given])
    drive = drive_of(given, segments(0), (stamps, np.zeros((6, 3))), model, 0.0)
    odometry = np.array([scan.odometry for scan in given])
    expected = model.correct(se2.between(odometry[:-1], odometry[1:]))
    assert se2.between(drive.odometry[:-1], drive.odometry[1:]) == pytest.approx(expected, abs=1e-12)
    assert np.hypot(*expected[0, :2]) < 0.95 * np.hypot(0.3, 0.1)


def test_a_turn_of_more_than_half_a_turn_in_a_gap_is_that_of_the_path() -> None:
    """Of wheels that measure turns 10 % too large, and were read all the time."""
    model = OdometryModel(Config().odometry)
    for _ in range(200):
        model.add_motion(np.array([0.1, 0.0, 0.44]), np.array([0.1, 0.0, 0.4]), 1e8 * np.eye(3))
    stamps, twist = np.linspace(0.5, 9.0, 100), np.array([1.0, 0.0, 1.1 * np.radians(170.0)])
    readings = np.array([se2.exp(share * twist) for share in np.linspace(0.0, 1.0, 100)])
    before, after = (ProcessedScan(float(stamps[row]), readings[row], NO_FEATURES) for row in (0, -1))
    poses = np.array([np.zeros(3), se2.exp([1.0, 0.0, np.radians(170.0)])])
    odometry = OdometrySegments([OdometryHistory.from_arrays(stamps, readings)], [0])
    drive = drive_of([before, after], odometry, (np.array([0.5, 9.0]), poses), model, 0.0)
    assert abs(se2.wrap(drive.odometry[1, 2] - poses[1, 2])) < np.radians(3.0)


def test_scans_whose_features_were_dropped_are_named() -> None:
    given = [ProcessedScan(0.5 * k, np.zeros(3), replace(NO_FEATURES)) for k in range(4)]  # each sees nothing
    kept = ScanSequence(given)
    kept.drop_features([2])
    placed = (kept.stamps, np.zeros((4, 3)))
    drive = drive_of(kept, segments(0), placed, OdometryModel(Config().odometry), 0.0)
    assert drive.dropped.tolist() == [False, False, True, False]


def test_readings_that_were_assumed_before_the_first_one_are_no_readings_of_the_drive() -> None:
    history = OdometryHistory.from_arrays(np.array([1.0, 1.1]), np.zeros((2, 3)))
    history.extend_back(0.0)
    placed, model = (np.array([0.0, 0.5, 1.0]), np.zeros((3, 3))), OdometryModel(Config().odometry)
    drive = drive_of(scans(3), OdometrySegments([history], [0]), placed, model, 0.0)
    assert drive.readings.tolist() == [1.0, 1.1]


def test_a_run_without_any_placed_scan_is_an_empty_drive() -> None:
    nothing = (np.zeros(0), np.zeros((0, 3)))
    assert len(drive_of(scans(3), segments(0), nothing, OdometryModel(Config().odometry), 0.0)) == 0


def test_only_the_first_of_many_parts_are_named() -> None:
    parts = SimpleNamespace(apart=range(1, 30), firsts=range(30), measured=[False] * 30)
    mapper = SimpleNamespace(
        landmarks=SimpleNamespace(parts=parts), keyframe_count=30, keyframe_poses=np.zeros((30, 3))
    )
    (suspect,) = unconnected_parts(mapper, list(range(100, 130)), 100.0)  # type: ignore[arg-type]
    assert "30 parts that no scan connects, beginning at 0:01, 0:02, 0:03, 0:04 and 25 later times;" in suspect.text


def test_looks_that_contradict_the_map_are_reported() -> None:
    mapper = SimpleNamespace(travelled=[0.5 * k for k in range(30)], keyframe_poses=np.zeros((30, 3)))
    stamps = list(range(100, 130))
    (suspect,) = contradicted_places(mapper, [4.0, 6.0, 9.0, 12.0], stamps)  # type: ignore[arg-type]
    assert (suspect.first, suspect.last) == (108.0, 124.0)
    assert "4 looks over 8 m" in suspect.text
    assert not contradicted_places(mapper, [], stamps)  # type: ignore[arg-type]

"""The test if the robot has left a part of the map, with the tracking results of the next scans in that part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry
from slam.config import Config
from slam.estimation.closure_monitor import ClosureMonitor
from slam.estimation.earlier_part import DECIDING_MARGIN, EarlierPart
from slam.estimation.slam_state import SlamState
from slam.geometry.segments import CornerPoints, Segments
from slam.localisation.tracking import TrackingResult, TrackingStatus
from slam.matching.point_matcher import MIN_KNOWN_POINTS
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import ScanPoints
from slam.preprocessing.preprocessor import ProcessedScan

from ..tracking_results import tracking_result

FEATURES = ScanFeatures(
    Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2))),
    CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=int), np.zeros((0, 2))),
    ScanPoints(np.zeros((0, 2))),
)
EXACT = np.zeros(3)


def earlier_part() -> EarlierPart:
    """Return the test of a part of the map in which the robot was last seen at the origin."""
    state = SlamState(Config())
    state.tracker.move_to(np.zeros(3), Odometry(-1.0, np.zeros(3)))
    return EarlierPart(state, ClosureMonitor())


def is_confirmed(monkeypatch: pytest.MonkeyPatch, results: list[TrackingResult], error: se2.Pose = EXACT) -> bool:
    """Return True if the robot is found not to have left the part, after scans with these results, a metre apart.

    error  of odometry: the pose of a scan in the frame of the one that odometry predicts, metres and radians
    """
    part = earlier_part()
    remaining = iter(results)

    def track(_: SlamState, scan: ProcessedScan, __: object) -> TrackingResult:
        return replace(next(remaining), pose=se2.compose(scan.odometry, error))

    monkeypatch.setattr("slam.estimation.earlier_part.track", track)
    for k in range(len(results)):
        part.add(ProcessedScan(float(k), np.array([float(k), 0.0, 0.0]), FEATURES))
    return part.confirmed


def test_scans_that_fit_well_show_that_the_robot_is_still_there(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not is_confirmed(monkeypatch, [tracking_result()] * (DECIDING_MARGIN - 1))
    assert is_confirmed(monkeypatch, [tracking_result()] * DECIDING_MARGIN)
    misfit = tracking_result(TrackingStatus.FAILED)
    assert not is_confirmed(monkeypatch, [misfit, *[tracking_result()] * DECIDING_MARGIN])
    assert is_confirmed(monkeypatch, [misfit, *[tracking_result()] * (DECIDING_MARGIN + 1)])


@pytest.mark.parametrize(
    "undecided",
    [
        tracking_result(poor=True),
        tracking_result(known=MIN_KNOWN_POINTS - 1),
        tracking_result(TrackingStatus.NO_FEATURES),
    ],
    ids=["poor", "unknown", "no features"],
)
def test_scans_that_fit_half_or_show_little_say_nothing(
    monkeypatch: pytest.MonkeyPatch, undecided: TrackingResult
) -> None:
    """In another building, half of the points fit the little that was mapped, scan after scan."""
    assert not is_confirmed(monkeypatch, [undecided] * 9)
    assert is_confirmed(monkeypatch, [*[undecided] * 9, *[tracking_result()] * DECIDING_MARGIN])


def test_scans_against_odometry_do_not_show_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not is_confirmed(monkeypatch, [tracking_result(slipped=True)] * 9)


@pytest.mark.parametrize("error", [[3.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2]], ids=["shifted", "turned"])
def test_scans_that_fit_one_after_the_other_where_odometry_did_not_lead_do_not_show_it(
    monkeypatch: pytest.MonkeyPatch, error: list[float]
) -> None:
    """A robot that was carried seemed to stand in another corridor of the part, as tracking had found a pose there."""
    assert not is_confirmed(monkeypatch, [tracking_result()] * 9, np.array(error))
    assert is_confirmed(monkeypatch, [tracking_result()] * 9, 0.01 * np.array(error))


def test_scans_that_would_not_count_are_left_out_once_the_robot_seems_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A lost robot took 64 ms a scan on a fast computer, most of it for this test."""
    part, tracked = earlier_part(), []

    def track(state: SlamState, scan: ProcessedScan, _: object) -> TrackingResult:
        tracked.append(scan.stamp)
        status = TrackingStatus.FAILED if scan.stamp < 10.0 else TrackingStatus.TRACKED
        return tracking_result(status, pose=scan.odometry)

    monkeypatch.setattr("slam.estimation.earlier_part.track", track)
    for stamp in range(10):  # 0.1 m apart
        part.add(ProcessedScan(float(stamp), np.array([0.1 * stamp, 0.0, 0.0]), FEATURES))
    begun = len(tracked)
    assert begun < 10
    for stamp in range(10, 20):  # the robot stands
        assert part.add(ProcessedScan(float(stamp), np.array([0.9, 0.0, 0.0]), FEATURES)) is None
    assert len(tracked) == begun
    for stamp in range(20, 20 + 2 * DECIDING_MARGIN):  # it drives where it was all the time
        part.add(ProcessedScan(float(stamp), np.array([float(stamp), 0.0, 0.0]), FEATURES))
    assert part.confirmed


def recognised(pose: se2.Pose, *, driven: float) -> bool:
    """Return True if the robot has not left the part, once it was recognised at a pose, by odometry `driven` metres."""
    part = earlier_part()
    recognised = part.recognise(pose, Odometry(1.0, np.array([driven, 0.0, 0.0])))
    assert part.confirmed == recognised
    return recognised


def test_a_robot_that_is_recognised_where_odometry_has_it_has_not_left() -> None:
    assert recognised(np.array([1.05, 0.02, 0.01]), driven=1.0)
    assert not recognised(np.array([1.0, 1.5, 0.0]), driven=1.0)


def test_odometry_that_knows_little_does_not_tell_where_a_recognised_robot_is() -> None:
    """After 100 m its uncertainty admits the pose, but the part would go on at another one."""
    assert not recognised(np.array([101.0, 1.0, 0.0]), driven=100.0)

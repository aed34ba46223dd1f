"""The pose is tracked while odometry fails, by a search with the scan points."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry
from drivers.simulation import LidarModel, Simulation, load_world
from slam import Finished, Slam
from slam.config import OdometryConfig
from slam.evaluation.benchmarks.scenarios.world_variants import add_crowd
from slam.events import EventRecorder, Notice
from slam.geometry.roughness import Roughness
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.localisation.match_target import MatchTarget, ScanMatch
from slam.localisation.tracker import Tracker
from slam.localisation.tracking import TrackingResult, TrackingStatus
from slam.mapping.local_map import empty_local_map
from slam.matching.offset_tiles import FIELD_CELL
from slam.matching.point_matcher import Prediction, match_points
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import ScanPoints
from slam.odometry.dead_reckoning import DeadReckoning
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import OdometryHistory
from slam.odometry.predicted_motion import PredictedMotionModel

from ..outlines import noisy_field, outline, scan_points, visible, with_noise

SMOOTH = Roughness(0.0, 0.0)
ROOM = outline([(0, 0), (5, 0), (5, 2), (3.5, 2), (3.5, 4), (0, 4)])  # angular, without symmetry
WIDE = np.diag(1 / np.array([0.6, 0.6, np.radians(25.0)]) ** 2)  # information of a prediction after odometry has failed
STANDS = np.array([1.8, 1.7, -0.35])
THINGS = (2.4, 1.4), (1.2, 2.3), (0.6, 0.5)  # corners of things around STANDS that are not in the map
SIZE = 1.0  # metres, larger than what may have moved
FULL_ROOM = np.concatenate(
    [ROOM, *[outline([(x, y), (x + SIZE, y), (x + SIZE, y + SIZE), (x, y + SIZE)]) for x, y in THINGS]]
)
WRONG, RIGHT, STOOD = (0.8, 0.9, 0.8), (0.25, 0.2, -0.35), (0.0, 0.0, 0.0)  # motions by odometry before STANDS
ROOM_FIELD = noisy_field(ROOM, np.array([1.5, 1.5, 0.0]))


@pytest.mark.parametrize("off", [[1.0, -0.8, 0.9], [-1.3, 0.2, -1.2], [0.0, 0.0, 0.0]])
def test_a_pose_is_found_far_from_its_prediction(off: list[float]) -> None:
    pose = np.array([1.5, 1.5, 0.4])
    found = match_points(ROOM_FIELD, scan_points(ROOM, pose), [Prediction(pose + off, WIDE)])[0]
    assert found.fit > 0.9
    assert np.abs(found.pose - pose)[:2].max() < FIELD_CELL
    assert abs(found.pose[2] - pose[2]) < np.radians(1.0)


class FailingOdometry:
    """Simulation whose odometry stands still for a while and then continues from there, or catches up (`makes_up`)."""

    def __init__(self, begin: float, end: float, *, makes_up: bool) -> None:
        self.source = Simulation(world="office", seed=1, duration=min(end + 12.0, 36.0), lidar=LidarModel(180, 5.0))
        self.begin, self.end, self.makes_up = begin, end, makes_up

    def __iter__(self) -> Iterator[Message]:
        start: float | None = None
        held: Odometry | None = None
        lost: se2.Pose | None = None
        for message in self.source:
            start = message.stamp if start is None else start
            if not isinstance(message, Odometry):
                yield message
                continue
            time = message.stamp - start
            if time < self.begin:
                held = message
            elif time < self.end:
                assert held is not None
                yield Odometry(message.stamp, held.pose)
                continue
            elif not self.makes_up:
                assert held is not None
                if lost is None:
                    lost = se2.compose(held.pose, se2.inverse(message.pose))
                yield Odometry(message.stamp, se2.compose(lost, message.pose))
                continue
            yield message


class ReversedOdometry:
    """Simulation whose odometry counts the wheels backwards for a while, as some bases do when they reverse."""

    def __init__(self, begin: float, end: float) -> None:
        self.source = Simulation(world="office", seed=2, duration=30.0, lidar=LidarModel(beams=180, rate=3.0))
        self.begin, self.end = begin, end

    def __iter__(self) -> Iterator[Message]:
        last: se2.Pose | None = None
        pose, start = np.zeros(3), None
        for message in self.source:
            start = message.stamp if start is None else start
            if isinstance(message, Odometry):
                x, y, turn = np.zeros(3) if last is None else se2.between(last, message.pose)
                wrong = self.begin < message.stamp - start < self.end
                pose, last = se2.compose(pose, np.array([-x if wrong else x, y, turn])), message.pose
                message = Odometry(message.stamp, pose)
            yield message


class LateOdometry:
    """A drive among people whose odometry is read late now and then, by up to 0.3 s, and then catches up."""

    def __init__(self, seed: int) -> None:
        world = add_crowd(load_world("office"), 10, np.random.default_rng(seed), 25.0)
        self._drive, self._seed = Simulation(world, seed, 25.0, LidarModel(180, 5.0)), seed

    def __iter__(self) -> Iterator[Message]:
        random, late_until, last = np.random.default_rng(self._seed), 0.0, np.zeros(3)
        for message in self._drive:
            if isinstance(message, Odometry):
                if message.stamp < late_until:
                    message = replace(message, pose=last)
                elif random.random() < 0.1:
                    late_until = message.stamp + random.uniform(0.0, 0.3)
                last = message.pose
            yield message


def drive(source: Iterable[Message]) -> tuple[Finished, Floats, list[str]]:
    """Return the result, the errors of the keyframes (k, 2) in metres and radians, and the texts of notices."""
    listener, truth = EventRecorder(), []
    slam = Slam(sinks=[listener])
    for message in source:
        slam.add(message)
        if isinstance(message, GroundTruth):
            truth.append([message.stamp, *message.pose])
    result = slam.finish()
    stamps, *columns = np.array(truth).T
    columns[2] = np.unwrap(columns[2])
    true = np.column_stack([np.interp(result.keyframes.stamps, stamps, column) for column in columns])
    error = se2.between(result.keyframes.poses, se2.between(true[0], true))
    notices = [notice.text for notice in listener.of(Notice)]
    return result, np.column_stack([np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])]), notices


@pytest.mark.parametrize("makes_up", [pytest.param(True, marks=pytest.mark.slow), False])
@pytest.mark.parametrize("begin", [8.0, pytest.param(22.0, marks=pytest.mark.slow)])
def test_odometry_that_stands_still_for_two_seconds_is_corrected(begin: float, makes_up: bool) -> None:
    _, errors, _ = drive(FailingOdometry(begin, begin + 2.0, makes_up=makes_up))
    assert errors[:, 0].max() < 0.10  # of a keyframe while it stands still
    assert errors[-10:, 0].max() < 0.03
    assert errors[-10:, 1].max() < 0.005


def test_the_evidence_of_a_tentative_scan_is_passed_on_to_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    match, track = MatchTarget.match, Tracker.track
    given, found = list[float](), [(0.0, False)]  # evidence of each scan, and True if its pose is tentative

    def observed_match(target: MatchTarget, *args: Any, **settings: Any) -> ScanMatch:
        result = match(target, *args, **settings)
        if (earlier := settings.get("earlier_evidence")) is not None:
            given.append(earlier)
            found.append((result.evidence, False))
        return result

    def observed_track(tracker: Tracker, *args: Any) -> TrackingResult:
        result = track(tracker, *args)
        found[-1] = found[-1][0], result.status is TrackingStatus.TENTATIVE
        return result

    monkeypatch.setattr(MatchTarget, "match", observed_match)
    monkeypatch.setattr(Tracker, "track", observed_track)
    drive(LateOdometry(9))
    assert given == [evidence if tentative else 0.0 for evidence, tentative in found[:-1]]
    assert any(given)


@pytest.mark.parametrize(
    "jump",
    [
        pytest.param([0.9, 0.0, 0.0], marks=pytest.mark.slow),
        pytest.param([0.0, -0.8, 0.3], marks=pytest.mark.slow),
        [-1.0, 0.4, -0.5],
    ],
)
def test_the_path_does_not_follow_a_jump_of_odometry(jump: list[float]) -> None:
    """Not even at the first scan after the jump, whose pose the next scan confirms."""
    slam, truth = Slam(), {}
    for message in Simulation(world="office", seed=1, duration=10.0, lidar=LidarModel(beams=180)):
        if isinstance(message, GroundTruth):
            truth[message.stamp] = message.pose
        if isinstance(message, Odometry) and message.stamp - min(truth) > 7.0:
            message = replace(message, pose=se2.compose(np.array(jump), message.pose))
        slam.add(message)
    scans, _ = slam.slam_state.trajectory.at_scans(slam.slam_state.mapper.keyframe_poses)
    result = slam.finish()
    stamps, true = np.array(list(truth)), np.array(list(truth.values()))
    at_scans = np.isin(result.stamps, scans)
    assert np.diff(scans).max() < 0.15  # none is missing
    errors = se2.between(true[0], true)
    expected = np.column_stack([np.interp(result.stamps[at_scans], stamps, errors[:, k]) for k in range(2)])
    assert np.hypot(*(result.poses[at_scans, :2] - expected).T).max() < 0.05


@pytest.mark.slow
def test_the_path_goes_on_evenly_while_odometry_counts_backwards() -> None:
    """The scans predict each other although they are few, and the robot is never lost."""
    result, errors, _ = drive(ReversedOdometry(10.0, 20.0))
    assert errors[:, 0].max() < 0.2
    assert "LOST" not in [state["state"] for state in result.summary["states"]]


def test_late_readings_of_odometry_are_no_failure() -> None:
    """Among people no scan fits well, but the poses of several in a row agree with each other.

    How long a reading is late differs: in one of six drives, the errors are three times the usual ones.
    """
    usual = []
    for seed in (9, 10, 12):
        result, errors, _ = drive(LateOdometry(seed))
        usual.append(np.sqrt(np.mean(errors[:, 0] ** 2)))
        assert errors[:, 0].max() < 0.1
        assert "LOST" not in [state["state"] for state in result.summary["states"]]
    assert np.median(usual) < 0.025


def test_no_notice_without_a_failure() -> None:
    _, errors, noticed = drive(Simulation("office", seed=1, duration=20.0, lidar=LidarModel(180, 5.0)))
    assert errors[:, 0].max() < 0.03
    assert noticed == []


def results_after_gap(
    gap: float,
    scans: int,
    room: Floats = ROOM,
    driven: tuple[float, float, float] = WRONG,
    model: OdometryModel | None = None,
    history: OdometryHistory | None = None,
) -> tuple[Tracker, list[TrackingResult]]:
    """Return the results of scans of a robot that stands, after a drive and some seconds without scans.

    The robot has not driven on as before the gap; see STANDS. `driven` is its motion in the gap by odometry, metres,
    metres and radians; `model` is that of odometry's errors, `history` has its readings.
    """
    tracker = Tracker(DeadReckoning(model or OdometryModel(OdometryConfig()), history))
    target = MatchTarget(empty_local_map(), ROOM_FIELD, SMOOTH)
    for k in range(12):
        pose = np.array([1.0 + 0.05 * k, 1.5, 0.0])
        if not k:
            tracker.move_to(pose, Odometry(0.0, pose))
        tracker.track(Odometry(0.1 * k, pose), seen_from(pose), target)
    odometry, seen = se2.compose(pose, np.array(driven)), seen_from(STANDS, room)
    return tracker, [tracker.track(Odometry(1.1 + gap + 0.1 * k, odometry), seen, target) for k in range(scans)]


@pytest.mark.parametrize(("driven", "lost"), [(RIGHT, False), (WRONG, True)])
def test_a_robot_that_drove_in_a_long_gap_is_placed_by_odometry_only(
    driven: tuple[float, float, float], lost: bool
) -> None:
    """An even motion predicts nothing then: another place where the scan fits is one of many that may look alike."""
    tracker, results = results_after_gap(10.0, 4, driven=driven)
    assert not any(result.poor for result in results)
    assert (results[-1].status is TrackingStatus.TRACKED) is not lost
    assert tracker.lost is lost
    assert lost or np.all(np.abs(se2.between(STANDS, results[-1].pose)) < [0.05, 0.05, 0.03])


def test_a_robot_that_drove_in_a_short_gap_is_found_against_odometry() -> None:
    _, results = results_after_gap(0.4, 2)
    assert results[-1].status is TrackingStatus.TRACKED
    assert np.all(np.abs(se2.between(STANDS, results[-1].pose)) < [0.05, 0.05, 0.03])


@pytest.mark.parametrize(
    ("gap", "driven", "lost"), [(0.4, WRONG, True), (0.4, RIGHT, False), (10.0, WRONG, True), (10.0, RIGHT, False)]
)
def test_scans_that_fit_badly_do_not_confirm_each_other(
    gap: float, driven: tuple[float, float, float], lost: bool
) -> None:
    """A robot that stands among things that were not there finds the same pose each time, which proves nothing.

    Poses that odometry predicts need no other confirmation. A robot that was lifted for two seconds had a second
    outline of the room in its map.
    """
    tracker, results = results_after_gap(gap, 4, FULL_ROOM, driven)
    assert all(result.poor for result in results)
    assert (results[-1].status is TrackingStatus.TRACKED) is not lost
    assert tracker.lost is lost


def test_scans_that_fit_well_against_odometry_do_not_confirm_a_tentative_pose_after_a_long_gap() -> None:
    """The robot was carried by seven metres, and a pose near the one where it stood before looked alike."""
    tracker, (first,) = results_after_gap(10.0, 1, FULL_ROOM, STOOD)
    assert first.status is TrackingStatus.TENTATIVE
    target, stood = MatchTarget(empty_local_map(), ROOM_FIELD, SMOOTH), np.array([1.55, 1.5, 0.0])
    seen = seen_from(se2.compose(STANDS, np.array([0.48, 0.68, -0.56])))
    results = [tracker.track(Odometry(11.1 + 0.1 * k, stood), seen, target) for k in range(1, 5)]
    assert not any(result.poor for result in results)
    assert tracker.lost


@pytest.mark.parametrize(("gap", "lost"), [(0.4, False), (10.0, True)])
def test_a_robot_whose_wheels_stood_in_a_long_gap_may_have_been_carried(gap: float, lost: bool) -> None:
    """It was carried, and the first scans fit poorly where it stood before: its map went on from there, 97 m wrong."""
    tracker, results = results_after_gap(gap, 4, FULL_ROOM, STOOD)
    assert all(result.poor for result in results)
    assert tracker.lost is tracker.may_have_been_carried is lost


@pytest.mark.parametrize(("silence", "lost"), [(1.0, False), (8.0, True)])
def test_poor_fits_after_a_gap_in_scans_and_odometry_place_no_robot(silence: float, lost: bool) -> None:
    """It was put back by three metres, and a fit of 14 % of the points began a second copy of the hall."""
    begin, end = np.array([1.55, 1.5, 0.0]), se2.compose([1.55, 1.5, 0.0], np.array(RIGHT))
    stamps = np.concatenate([np.arange(0.0, 2.0, 0.1), np.arange(2.0 + silence, 12.0, 0.1)])
    poses = np.where(stamps[:, None] < 2.0, begin, end)
    history = OdometryHistory.from_arrays(stamps, poses)
    tracker, results = results_after_gap(10.0, 4, FULL_ROOM, RIGHT, history=history)
    assert all(result.poor for result in results)
    assert tracker.lost is lost


@pytest.mark.parametrize(("silence", "lost"), [(1.0, False), (8.0, True)])
def test_scans_of_an_unseen_place_after_a_gap_in_scans_and_odometry_place_no_robot(silence: float, lost: bool) -> None:
    """It was put elsewhere in the room, and a pose outside of it, where nothing contradicts a scan, was taken."""
    begin, driven = np.array([1.55, 1.5, 0.0]), (30.0, 0.0, 0.0)
    stamps = np.concatenate([np.arange(0.0, 2.0, 0.1), np.arange(2.0 + silence, 12.0, 0.1)])
    poses = np.where(stamps[:, None] < 2.0, begin, se2.compose(begin, np.array(driven)))
    history = OdometryHistory.from_arrays(stamps, poses)
    tracker, results = results_after_gap(10.0, 4, ROOM, driven, history=history)
    assert not any(result.known for result in results)
    assert tracker.lost is lost


@pytest.mark.parametrize(("gap", "lost"), [(0.4, False), (10.0, True)])
def test_without_odometry_poor_fits_after_a_long_gap_place_no_robot(gap: float, lost: bool) -> None:
    """Nothing predicts where it is, and most scans fit somewhere."""
    tracker, results = results_after_gap(gap, 4, FULL_ROOM, STOOD, PredictedMotionModel(OdometryConfig(source="none")))
    assert results[0].poor
    assert tracker.lost is lost


def test_a_robot_whose_wheels_stood_in_a_long_gap_is_found_if_the_scans_fit() -> None:
    tracker, results = results_after_gap(10.0, 1, ROOM, STOOD)
    assert results[0].status is not TrackingStatus.FAILED
    assert not tracker.lost


@pytest.mark.parametrize(("moved", "carried"), [((0.0, 0.05, 0.4), True), ((0.0, 0.0, 0.0), False)])
def test_a_robot_that_stands_where_no_motion_leads_was_carried(
    moved: tuple[float, float, float], carried: bool
) -> None:
    """Its scans fit well and agree with each other, but a place out of reach may be anywhere and look alike."""
    tracker = Tracker(DeadReckoning(OdometryModel(OdometryConfig())))
    target = MatchTarget(empty_local_map(), ROOM_FIELD, SMOOTH)
    stood = np.array([1.5, 1.5, 0.0])
    tracker.move_to(stood, Odometry(0.0, stood))
    for k in range(30):
        tracker.track(Odometry(0.1 * k, stood), seen_from(stood), target)
    for k in range(30, 34):
        result = tracker.track(Odometry(0.1 * k, stood), seen_from(se2.compose(stood, np.array(moved))), target)
        assert not result.poor
    assert tracker.lost is tracker.may_have_been_carried is carried


def test_a_scan_out_of_reach_is_forgotten_if_the_next_one_fits() -> None:
    """Afterwards the robot may be pushed as before."""
    tracker = Tracker(DeadReckoning(OdometryModel(OdometryConfig())))
    target = MatchTarget(empty_local_map(), ROOM_FIELD, SMOOTH)
    stood = np.array([1.5, 1.5, 0.0])
    motions = [*30 * [(0.0, 0.0, 0.0)], (0.0, 0.05, 0.4), (0.0, 0.0, 0.0), (0.12, 0.0, 0.0)]
    tracker.move_to(stood, Odometry(0.0, stood))
    results = [
        tracker.track(Odometry(0.1 * k, stood), seen_from(se2.compose(stood, np.array(motion))), target)
        for k, motion in enumerate(motions)
    ]
    expected = [TrackingStatus.FAILED, TrackingStatus.TRACKED, TrackingStatus.TRACKED]
    assert [result.status for result in results[-3:]] == expected


@pytest.mark.parametrize("slips", [False, True])
def test_only_a_slip_that_the_last_metres_show_is_believed(slips: bool) -> None:
    """The field shows the room also as an earlier pass has mapped it, half a metre aside: a loop has to be closed."""
    begin, aside = np.array([1.0, 1.5, 0.0]), np.array([0.0, 0.5, 0.0])
    recent = noisy_field(ROOM, begin)
    earlier = noisy_field(ROOM + aside[:2], begin + aside)
    tracker = Tracker(DeadReckoning(OdometryModel(OdometryConfig())))
    for k in range(8):
        pose = begin + np.array([0.05 * k, 0.0, 0.0])
        if not k:
            tracker.move_to(pose, Odometry(0.0, pose))
        tracker.track(Odometry(0.1 * k, pose), seen_from(pose), MatchTarget(empty_local_map(), recent, SMOOTH))
    pose = pose + (aside if slips else np.zeros(3)) + np.array([0.05, 0.0, 0.0])
    odometry = begin + np.array([0.4, 0.0, 0.0])
    field = recent if slips else earlier
    for k in (8, 9):
        result = tracker.track(
            Odometry(0.1 * k, odometry), seen_from(pose), MatchTarget(empty_local_map(), field, SMOOTH, lambda: recent)
        )
    assert result.contradicts_old_map is not slips
    assert result.status is TrackingStatus.TRACKED
    assert np.all(np.abs(se2.between(pose, result.pose)) < [0.03, 0.03, 0.02])


def test_a_sudden_turn_in_a_round_room_is_found_without_odometry() -> None:
    """A scan of the round wall fits at all headings, and only the two boxes in the room show that it has turned."""
    angles = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    wall = outline([(3.0 * np.cos(angle), 3.0 * np.sin(angle)) for angle in angles])
    boxes = [outline([(x, y), (x + 0.4, y), (x + 0.4, y + 0.4), (x, y + 0.4)]) for x, y in [(1.8, 0.5), (-0.6, -2.0)]]
    room = np.concatenate([wall, *boxes])
    target = MatchTarget(empty_local_map(), noisy_field(room, np.zeros(3)), SMOOTH)
    for turn in (-0.6, -0.4, 0.4, 0.6):
        tracker = Tracker(DeadReckoning(PredictedMotionModel(OdometryConfig(source="none"))))
        pose = odometry = np.zeros(3)
        tracker.move_to(pose, Odometry(0.0, odometry))
        for k in range(20):  # standing still, until the motion is predicted to be none
            result = tracker.track(Odometry(0.25 * k, odometry), seen_from(pose, room), target)
        pose = np.array([0.05, 0.0, turn])
        result = tracker.track(Odometry(0.25 * 20, odometry), seen_from(pose, room), target)
        assert np.all(np.abs(se2.between(pose, result.pose)) < [0.03, 0.03, 0.02])


def seen_from(pose: Floats, room: Floats = ROOM) -> ScanFeatures:
    """Return a scan of a room without lines."""
    points = with_noise(visible(room, pose), np.random.default_rng(1))
    segments = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
    corners = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))
    return ScanFeatures(segments, corners, ScanPoints(points))

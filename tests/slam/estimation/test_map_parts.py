"""A robot that does not know where it is keeps mapping, in a part of the map of its own until that is recognised."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.simulation import LidarModel, Simulation, World
from slam import Finished, Slam
from slam.config import Config, config_to_toml
from slam.estimation.estimator import Estimator
from slam.estimation.scan_update import track
from slam.estimation.slam_state import SlamState
from slam.io.output_dir import CONFIG
from slam.io.sessions import read_session, write_session
from slam.io.tum import Trajectory
from slam.localisation.tracking import TrackingResult
from slam.loop_closure.agreement import LoopAgreement
from slam.loop_closure.loop_status import LoopStatus
from slam.mapping.convergence import converge
from slam.mapping.part_gauge import PartGauge
from slam.odometry.error_model import OdometryModel
from slam.odometry.measurement_clock import PERIOD_SAMPLES
from slam.preprocessing.preprocessor import Preprocessor, ProcessedScan
from slam.reporting.publisher import Publisher
from slam.reporting.run_statistics import RunStatistics
from slam.reporting.scan_report import ScanReport

from ..simulated_worlds import furnished_room

LOST_AT, DURATION = 10.0, 60.0  # seconds of a drive through a room
ROBOT = LidarModel(beams=180, rate=3.0)


BARE_WALLS = np.array([[0.0, 0.0, 8.0, 0.0], [8.0, 0.0, 8.0, 6.0], [8.0, 6.0, 0.0, 6.0], [0.0, 6.0, 0.0, 0.0]])
BARE_PATH = np.array([[1.2, 1.2], [6.8, 1.2], [6.8, 4.8], [1.2, 4.8], [1.2, 1.2]])


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("room", seed=1, duration=DURATION, lidar=ROBOT))


@pytest.fixture(scope="module")
def scans(drive: list[Message]) -> list[ProcessedScan]:
    return process(drive)


@pytest.fixture(scope="module")
def furnished_drive() -> list[Message]:
    """Drive through the room with a cupboard at one of its walls."""
    return list(Simulation(furnished_room(), seed=1, duration=DURATION, lidar=ROBOT))


@pytest.fixture(scope="module")
def bare_scans() -> list[ProcessedScan]:
    """Drive through a bare room, which looks the same from the opposite side."""
    bare = World("bare", "a bare room", BARE_WALLS, np.zeros((0, 3)), BARE_PATH, 0.7)
    return process(list(Simulation(bare, seed=1, duration=DURATION, lidar=ROBOT)))


def process(drive: list[Message]) -> list[ProcessedScan]:
    preprocessor, processed = Preprocessor(Config()), []
    for message in drive:
        if isinstance(message, GroundTruth):
            continue
        preprocessor.add(message)
        while (scan := preprocessor.next_scan()) is not None:
            processed.append(preprocessor.process(scan, OdometryModel(Config().odometry)))
    return processed


def lose(
    scans: list[ProcessedScan], shift: se2.Pose, *, kidnapped: bool, at: float = LOST_AT
) -> tuple[Estimator, list[int]]:
    """Map scans with an estimator whose pose is declared lost after `at` seconds, and is wrong by `shift` from then on.

    Returns the estimator and the first keyframes of the parts that it joined.
    """
    estimator, joined = Estimator(SlamState(Config())), []
    for scan in scans:
        if scan.stamp - scans[0].stamp > at and len(estimator.state.mapper.landmarks.parts) == 1:
            pose = se2.compose(estimator.state.predict(scan.reading), shift)
            estimator.begin_part(pose, scan.reading, kidnapped=kidnapped)
        result = estimator.process(scan)
        joined += [] if result.joined is None else [result.joined]
    return estimator, joined


def position_errors(estimator: Estimator, drive: list[Message]) -> np.ndarray:
    """Return the errors of the keyframes' positions relative to the first one, metres."""
    truth = [message for message in drive if isinstance(message, GroundTruth)]
    true = Trajectory(np.array([m.stamp for m in truth]), np.array([m.pose for m in truth]))
    poses = true.at(np.array(estimator.state.keyframe_stamps)).poses
    mapper = estimator.state.mapper
    errors = se2.between(mapper.graph.keyframe_poses(mapper.keyframe_count), se2.between(poses[0], poses))
    return np.hypot(errors[:, 0], errors[:, 1])


@pytest.mark.slow
def test_a_lost_robot_maps_on_and_is_joined_where_odometry_has_it(
    scans: list[ProcessedScan], drive: list[Message]
) -> None:
    """The room looks nearly the same from the opposite side, but odometry excludes that."""
    estimator, joined = lose(scans, np.array([0.02, 0.01, 0.01]), kidnapped=False)
    parts = estimator.state.mapper.landmarks.parts
    assert joined == parts.firsts[1:]
    assert len(joined) == 1
    assert not parts.apart
    assert position_errors(estimator, drive).max() < 0.03
    assert len(estimator.state.trajectory) == len(scans)


def test_a_robot_that_was_carried_is_not_joined_at_an_ambiguous_place(bare_scans: list[ProcessedScan]) -> None:
    scans = bare_scans[: len(bare_scans) // 2]
    estimator, joined = lose(scans, np.zeros(3), kidnapped=True)
    assert not joined
    assert len(estimator.state.trajectory) == len(scans)


@pytest.mark.slow
def test_a_robot_that_was_carried_is_joined_by_what_distinguishes_the_place(furnished_drive: list[Message]) -> None:
    """Some furniture tells the room from the room turned by 180 degrees, wherever odometry has put the robot."""
    scans = process(furnished_drive)
    estimator, joined = lose(scans[: len(scans) // 2], np.array([3.0, -2.0, 1.0]), kidnapped=True)
    assert joined == estimator.state.mapper.landmarks.parts.firsts[1:]
    assert len(joined) == 1
    assert position_errors(estimator, furnished_drive).max() < 0.03


@pytest.mark.slow
def test_a_place_that_odometry_excludes_is_not_joined(scans: list[ProcessedScan]) -> None:
    """The robot was not carried, as far as it knows, so that place must be another one that looks alike."""
    estimator, joined = lose(scans, np.array([4.0, -3.0, 2.5]), kidnapped=False)
    assert not joined
    assert len(estimator.state.trajectory) == len(scans)


@pytest.mark.slow
@pytest.mark.parametrize("shift", [(1.5, -1.0, 0.5), (0.8, -0.5, 0.1)])
def test_a_part_is_searched_everywhere_if_scans_contradict_the_place_where_odometry_has_it(
    furnished_drive: list[Message], shift: tuple[float, float, float]
) -> None:
    """Odometry is wrong by more than its covariance admits: the room does not look as it would there.

    Looks are searched for farther than loops are closed, and the smaller error is in between.
    """
    scans = process(furnished_drive)
    estimator, joined = lose(scans, np.array(shift), kidnapped=False, at=DURATION / 3.0)
    assert joined == estimator.state.mapper.landmarks.parts.firsts[1:]
    assert position_errors(estimator, furnished_drive).max() < 0.03


def test_the_report_states_why_a_part_was_not_joined(scans: list[ProcessedScan]) -> None:
    """The drive ends before enough looks at the earlier part agree; the number can be given to `wclm correct`."""
    estimator, joined = lose(scans[: len(scans) // 2], np.array([0.02, 0.01, 0.01]), kidnapped=False)
    assert not joined
    statistics = RunStatistics()
    ScanReport(Publisher([]), statistics).end(estimator.state, scans[-1].stamp)
    first, (row, *_) = estimator.state.mapper.landmarks.parts.firsts[1], statistics.loops
    assert row["status"] == LoopStatus.REJECTED
    assert row["old"] < first <= row["keyframe"]
    assert "looks" in row["reason"]
    assert len({row["candidate"] for row in statistics.loops}) == len(statistics.loops)


@pytest.mark.parametrize("kidnapped", [False, True])
def test_the_covariance_between_parts_is_that_of_odometry(scans: list[ProcessedScan], kidnapped: bool) -> None:
    """Also in the graph, after the run has ended; within the part, covariances are small.

    The scans end before the part is recognised.
    """
    estimator, _ = lose(scans[: next(k for k, s in enumerate(scans) if s.stamp - scans[0].stamp > LOST_AT + 1.5)],
                        np.zeros(3), kidnapped=kidnapped)  # fmt: skip
    mapper = estimator.state.mapper
    first, last = mapper.landmarks.parts.firsts[1], mapper.keyframe_count - 1
    assert first < last
    for _ in range(2):
        across = np.sqrt(np.diag(mapper.covariances.relative(first - 1, first)))
        assert np.all(across > (5.0, 5.0, 1.0) if kidnapped else across < (0.5, 0.5, 0.5))
        assert np.sqrt(np.diag(mapper.covariances.relative(first, last))).max() < 0.05
        converge(mapper)


@pytest.mark.slow
def test_kept_covariances_between_parts_stay_right(bare_scans: list[ProcessedScan]) -> None:
    """Those of the part that is not mapped now are computed once, although the graph changes with each keyframe."""
    estimator, _ = lose(bare_scans[: len(bare_scans) // 2], np.zeros(3), kidnapped=True)
    mapper, (_, first) = estimator.state.mapper, estimator.state.mapper.landmarks.parts.firsts
    for scan in bare_scans[len(bare_scans) // 2 :][:40]:
        for old in (0, first // 2, first - 1):
            last = mapper.keyframe_count - 1
            kept = mapper.covariances.relative(old, last)
            computed = PartGauge(mapper.gauge.motion).covariance_across(mapper, old, last)
            np.testing.assert_allclose(kept, computed, rtol=1e-3, atol=1e-9)
        estimator.process(scan)
    assert mapper.keyframe_count - first > 10


@pytest.mark.slow
def test_a_robot_that_is_lost_again_maps_another_part(bare_scans: list[ProcessedScan]) -> None:
    """The covariance between the first and the last part contains odometry's motions to both later ones."""
    estimator, _ = lose(bare_scans[: len(bare_scans) // 2], np.zeros(3), kidnapped=True)
    scan = bare_scans[len(bare_scans) // 2]
    estimator.begin_part(estimator.state.predict(scan.reading), scan.reading, kidnapped=False)
    for scan in bare_scans[len(bare_scans) // 2 :][:20]:
        estimator.process(scan)
    mapper, (_, second, third) = estimator.state.mapper, estimator.state.mapper.landmarks.parts.firsts
    assert np.sqrt(mapper.covariances.relative(second, third)[0, 0]) < 0.5
    assert np.sqrt(mapper.covariances.relative(0, third)[0, 0]) > 5.0


@pytest.mark.slow
def test_a_part_that_was_left_is_joined_as_well(scans: list[ProcessedScan], drive: list[Message]) -> None:
    """The second part is too short to be recognised while it is mapped; the third one comes to its places."""
    estimator, again = Estimator(SlamState(Config())), iter([LOST_AT, LOST_AT + 4.0, np.inf])
    lost_at = next(again)
    for scan in scans:
        if scan.stamp - scans[0].stamp > lost_at:
            pose = se2.compose(estimator.state.predict(scan.reading), np.array([0.03, -0.02, 0.01]))
            estimator.begin_part(pose, scan.reading, kidnapped=False)
            lost_at = next(again)
        estimator.process(scan)
    parts = estimator.state.mapper.landmarks.parts
    assert len(parts) == 3
    assert not parts.apart
    assert position_errors(estimator, drive).max() < 0.03


@pytest.mark.slow
def test_a_robot_that_was_lost_on_a_frozen_map_keeps_its_scans(scans: list[ProcessedScan]) -> None:
    estimator, scans = Estimator(SlamState(Config())), scans[: len(scans) // 2]
    for scan in scans:
        estimator.process(scan)
    state = estimator.state
    state.freeze()
    walls, first = len(state.mapper.landmarks.walls), scans[0]
    estimator.begin_part(np.array([0.05, -0.04, 0.02]), first.reading, kidnapped=False)
    joined = None
    for scan in scans:
        result = estimator.process(replace(scan, stamp=scan.stamp + DURATION + 1.0))
        joined = result.joined or joined
        assert result.update is None
    assert joined == state.mapper.keyframe_count
    assert len(estimator.state.mapper.landmarks.walls) == walls
    stamps, poses = estimator.state.trajectory.at_scans(estimator.state.mapper.keyframe_poses)
    assert len(stamps) == 2 * len(scans)
    apart = se2.between(poses[: len(scans)], poses[len(scans) :])
    assert np.hypot(apart[:, 0], apart[:, 1]).max() < 0.05


def elsewhere(first: str, second: str, seconds: float, rate: float = 10.0) -> list[Message]:
    """Return the messages of a robot that is carried from one world to another after some seconds."""
    lidar = LidarModel(beams=180, rate=rate)
    messages = list(Simulation(first, seed=1, duration=seconds, lidar=lidar))
    odometry = next(message.pose for message in reversed(messages) if isinstance(message, Odometry))
    later = list(Simulation(second, seed=2, duration=seconds, lidar=lidar))
    start = next(message.pose for message in later if isinstance(message, Odometry))
    delay = messages[-1].stamp - later[0].stamp + 1.0
    for message in later:
        if isinstance(message, Odometry):
            message = replace(message, pose=se2.compose(odometry, se2.between(start, message.pose)))
        messages.append(replace(message, stamp=message.stamp + delay))
    return messages


@pytest.fixture(scope="module")
def carried() -> tuple[Slam, Finished]:
    slam = Slam()
    for message in elsewhere("office", "room", 12.0):
        slam.add(message)
    return slam, slam.finish()


def test_a_robot_carried_to_another_building_maps_it_apart(carried: tuple[Slam, Finished]) -> None:
    slam, finished = carried
    summary = finished.summary
    parts, states, suspects = (summary[name] for name in ("parts", "states", "suspects"))
    assert isinstance(parts, list)
    assert isinstance(states, list)
    assert isinstance(suspects, list)
    assert [part["odometry"] for part in parts] == [True, False]
    assert [part["joined"] for part in parts] == [True, False]
    assert [state["state"] for state in states] == ["LOST"]
    assert "2 parts that no scan connects" in suspects[0]["sentence"]
    assert len(slam.slam_state.trajectory) == summary["scans"]


@pytest.mark.slow
def test_scans_that_are_tracked_again_at_the_beginning_of_a_part_are_no_burst() -> None:
    """A part begins with the scans that fitted nowhere before; with stamps that go back, no interval would be right."""
    slam = Slam()
    for message in elsewhere("office", "room", 8.0):
        slam.add(message)
    state = slam.slam_state
    assert len(state.mapper.landmarks.parts) == 2
    assert state.checkpoint.tracker is not None
    intervals = np.array(state.checkpoint.tracker.intervals)
    assert len(intervals) == PERIOD_SAMPLES
    assert np.sort(intervals)[:-1] == pytest.approx(0.1)
    assert intervals.max() == pytest.approx(1.2)  # in which the robot was carried


def test_the_first_keyframe_of_a_map_on_trial_is_no_result(
    scans: list[ProcessedScan], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot is put down on a frozen map: its view has changed, although the scan fits where odometry has it."""
    estimator, (*before, last) = Estimator(SlamState(Config())), scans[: len(scans) // 2]
    for scan in before:
        estimator.process(scan)
    estimator.freeze()
    frozen, results = estimator.state.mapper, iter([True, False])

    def track_after_carrying(*arguments: Any) -> TrackingResult:
        return replace(track(*arguments), fits_by_chance=next(results))

    monkeypatch.setattr("slam.estimation.estimator.track", track_after_carrying)
    result = estimator.process(last)
    assert result.began_part
    assert estimator.state.mapper.keyframe_count > frozen.keyframe_count
    assert (result.update, result.mapper) == (None, frozen)


def test_parts_and_searches_for_their_place_are_stored_with_a_session(
    carried: tuple[Slam, Finished], tmp_path: Path
) -> None:
    slam, _ = carried
    directory, motion = tmp_path / "out", np.array([1.0, 2.0, 0.5])
    directory.mkdir()
    (directory / CONFIG).write_text(config_to_toml(Config()))
    session = slam.session
    session.slam_state.joins.agreements[0] = LoopAgreement(joins=True)
    session.slam_state.joins.exclude(motion)
    write_session(directory, session)
    state = read_session(directory).slam_state
    assert state.mapper.landmarks.parts.firsts == slam.slam_state.mapper.landmarks.parts.firsts
    assert state.mapper.landmarks.parts.apart == [1]
    np.testing.assert_array_equal(state.joins.states[0].retracted, [motion])


@pytest.mark.slow
def test_an_interrupted_run_maps_on_in_the_same_part(tmp_path: Path) -> None:
    messages = elsewhere("office", "room", 12.0)
    slam = Slam()
    for message in messages[: len(messages) * 3 // 4]:
        slam.add(message)
    slam.finish()
    directory = tmp_path / "out"
    directory.mkdir()
    (directory / CONFIG).write_text(config_to_toml(Config()))
    write_session(directory, slam.session)
    resumed = Slam(resumed=read_session(directory))
    for message in messages[len(messages) * 3 // 4 :]:
        resumed.add(message)
    finished, parts = resumed.finish(), resumed.slam_state.mapper.landmarks.parts
    assert parts.apart == [1]
    assert np.sqrt(resumed.slam_state.mapper.covariances.relative(parts.firsts[1] - 1, parts.firsts[1])[0, 0]) > 5.0
    assert len(resumed.slam_state.trajectory) == sum(isinstance(message, Scan) for message in messages)
    after = finished.keyframes.stamps > messages[len(messages) * 3 // 4].stamp
    truth = [message for message in messages if isinstance(message, GroundTruth)]
    true = Trajectory(np.array([m.stamp for m in truth]), np.array([m.pose for m in truth]))
    first = parts.firsts[1]
    moved = se2.between(finished.keyframes.poses[first], finished.keyframes.poses[after])
    expected = true.at(finished.keyframes.stamps[first:]).poses
    error = moved - se2.between(expected[0], expected[after[first:]])
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.03

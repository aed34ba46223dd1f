"""The whole pipeline on simulated drives, and with late, missing, empty or damaged messages."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.simulation import LidarModel, Simulation
from slam import Config, Slam
from slam.errors import ArgumentError, MapError, SlamError
from slam.evaluation.metrics import score_reference
from slam.events import EventRecorder, Finished, GroundTruthReceived, KeyframeAdded, MapUpdated, Notice, ScanTracked
from slam.io.tum import Trajectory
from slam.localisation.local_field import LocalField
from slam.loop_closure.agreement import LoopAgreement
from slam.loop_closure.decision import LoopDecision, LoopMatch
from slam.loop_closure.loop_status import LoopStatus
from slam.mapping.mapper import Mapper
from slam.preprocessing.deskew import sweep_middle


def run(messages: Iterable[Message], config: Config | None = None, listener: EventRecorder | None = None) -> Finished:
    slam = Slam(config, [listener] if listener else [])
    for message in messages:
        slam.add(message)
    return slam.finish()


def error(finished: Finished, messages: Iterable[Message]) -> float:
    """Return the RMS distance from the true trajectory, metres."""
    truth = [message for message in messages if isinstance(message, GroundTruth)]
    reference = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    return score_reference(Trajectory(finished.stamps, finished.poses), reference).figures()["ate_rmse"]


def without_ground_truth(messages: Iterable[Message]) -> list[Message]:
    return [message for message in messages if not isinstance(message, GroundTruth)]


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("room", seed=3, duration=14.0, lidar=LidarModel(beams=180, rate=5.0)))


@pytest.fixture(scope="module")
def drive_with_frequent_scans() -> list[Message]:
    return list(Simulation("room", seed=3, duration=14.0, lidar=LidarModel(beams=180, rate=10.0)))


@pytest.fixture(scope="module")
def result_with_frequent_scans(drive_with_frequent_scans: list[Message]) -> Finished:
    return run(without_ground_truth(drive_with_frequent_scans))


@pytest.fixture(scope="module")
def drive_result(drive: list[Message]) -> Finished:
    return run(drive)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"config": "a.toml"}, "config must be a Config, not str; load_config reads settings from a file"),
        ({"resumed": "map"}, "resumed must be a StoredSession, not str; slam.io.sessions.read_session reads it"),
        ({"plan": "a.dxf"}, "plan must be a PlanMap, not str"),
        ({"sinks": print}, "sinks must be a list of sinks, not builtin_function_or_method"),
        ({"sinks": [print]}, r"a sink must have a method handle\(event\), which builtin_function_or_method has not"),
    ],
)
def test_an_argument_of_another_type_is_refused_in_one_line(arguments: dict[str, Any], problem: str) -> None:
    with pytest.raises(ArgumentError, match=problem):
        Slam(**arguments)


def test_a_robot_that_only_stands_maps_what_it_sees_but_not_who_passes(drive: list[Message]) -> None:
    first = next(message for message in drive if isinstance(message, Scan))
    walker, ahead = replace(first, ranges=first.ranges.copy()), np.abs(first.angles) < 0.3
    walker.ranges[ahead] = 0.8 / np.cos(first.angles[ahead])  # a flat board in front of the lidar
    standing: list[Message] = [Odometry(0.05 * k, np.zeros(3)) for k in range(81)]
    standing += [replace(walker if k < 10 else first, stamp=0.1 * k) for k in range(40)]
    finished = run(sorted(standing, key=lambda message: message.stamp))
    assert len(finished.keyframes) == 2
    assert len(finished.walls) >= 3
    assert np.abs(finished.walls.frame[:, :2]).max(axis=1).min() > 1.0  # none is where the board was
    assert len(run(message for message in standing if message.stamp < 1.9).walls) == 0


@pytest.mark.parametrize(
    ("jump", "levels"),
    [
        ([0.0, 0.0, np.radians(8.0)], ["TRACE"]),
        ([0.0, 0.0, np.radians(20.0)], ["INFO", "WARN"]),  # at once, and for all scans together at the end
    ],
)
def test_odometry_that_contradicts_a_scan_is_a_warning_only_if_it_is_far_off(
    drive: list[Message], jump: list[float], levels: list[str]
) -> None:
    listener, last = EventRecorder(), np.zeros(3)
    slam = Slam(sinks=[listener])
    for message in drive:
        if isinstance(message, Odometry) and message.stamp <= 8.0:
            last = message.pose
        elif isinstance(message, Odometry):
            message = replace(message, pose=se2.compose(se2.compose(last, jump), se2.between(last, message.pose)))
        slam.add(message)
    slam.finish()
    assert [event.level for event in listener.of(Notice) if "odometry" in event.text] == levels


@pytest.mark.parametrize(
    ("world", "duration", "bound"), [("room", 20.0, 0.006), pytest.param("office", 20.0, 0.015, marks=pytest.mark.slow)]
)
def test_simulated_drives_are_tracked_to_millimetres(world: str, duration: float, bound: float) -> None:
    messages = list(Simulation(world, seed=1, duration=duration, lidar=LidarModel(beams=180, rate=4.0)))
    finished = run(messages)
    assert error(finished, messages) < bound
    odometry = [message.stamp for message in messages if isinstance(message, Odometry)]
    middles = [sweep_middle(message) for message in messages if isinstance(message, Scan)]
    assert np.isin(odometry, finished.stamps).all()
    assert np.abs(finished.stamps[:, None] - middles).min(axis=0).max() < 1e-6
    assert (np.diff(finished.stamps) > 0.0).all()
    assert np.isfinite(finished.poses).all()
    for covariance in (finished.walls.covariance, finished.corners.covariance):
        assert np.linalg.eigvalsh(covariance).min() > 0
    assert (finished.walls.high > finished.walls.low).all()


def test_a_finished_run_takes_no_more_messages(drive: list[Message]) -> None:
    slam = Slam()
    for message in drive[: len(drive) // 4]:
        slam.add(message)
    slam.finish()
    with pytest.raises(SlamError, match="the run has ended"):
        slam.add(drive[-1])


def test_a_room_has_its_walls_and_corners(drive_result: Finished) -> None:
    length = drive_result.walls.high - drive_result.walls.low
    long = np.sort(length[length > 3.5])
    np.testing.assert_allclose(long, [4.2, 4.2, 6.4, 6.4], atol=0.1)
    assert 4 <= len(drive_result.walls) <= 12
    assert len(drive_result.corners) >= 4


def test_events_are_complete_and_in_order(drive: list[Message]) -> None:
    listener = EventRecorder()
    finished = run(drive, listener=listener)
    scans = [message for message in drive if isinstance(message, Scan)]
    keyframes, tracked = listener.of(KeyframeAdded), listener.of(ScanTracked)
    assert [event.index for event in keyframes] == list(range(len(finished.keyframes)))
    assert [event.stamp for event in keyframes] == list(finished.keyframes.stamps)
    assert len(tracked) == len(scans)
    assert (np.diff([event.stamp for event in tracked]) > 0).all()
    assert len(listener.of(GroundTruthReceived)) == sum(isinstance(message, GroundTruth) for message in drive)
    assert listener.events[-1] is finished
    assert listener.of(MapUpdated)[0].index == 0
    seen: set[int] = set()
    for event in keyframes:
        assert len(event.wall_match) == len(event.wall_gate) == len(event.segments)
        assert len(event.corner_match) == len(event.corner_gate) == len(event.corners)
        assert not seen & set(event.new_walls)
        seen |= set(event.new_walls)
        assert set(event.wall_match[event.wall_match >= 0]) <= seen
        assert np.linalg.eigvalsh(event.pose_covariance).min() > 0
        assert len(event.points) > 0
        assert np.isfinite(event.points).all()
    assert set(finished.walls.identity) <= seen


def test_walls_are_counted_while_mapping_as_in_the_finished_map(drive: list[Message]) -> None:
    listener = EventRecorder()
    finished = run(drive, listener=listener)
    counts = [event.counts for event in listener.of(KeyframeAdded)]
    assert counts[0] == {"walls": 0, "corners": 0, "keyframes": 1}  # one keyframe confirms no wall
    assert counts[-1]["walls"] == len(finished.walls)
    assert counts[-1]["corners"] == len(finished.corners)


def test_repeated_runs_with_and_without_sinks_are_identical(drive: list[Message], drive_result: Finished) -> None:
    again = run(drive, listener=EventRecorder())
    assert again.poses.tobytes() == drive_result.poses.tobytes()
    assert again.walls.frame.tobytes() == drive_result.walls.frame.tobytes()
    assert again.walls.covariance.tobytes() == drive_result.walls.covariance.tobytes()
    assert again.corners.position.tobytes() == drive_result.corners.position.tobytes()


def test_sinks_receive_what_they_handle_and_the_rest_is_not_built(
    drive: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Notices(EventRecorder):
        handled = (Notice, ScanTracked)

    def fail(*_: object) -> None:
        raise AssertionError("an event was built that no sink receives")

    for name in ("reporting.publisher.map_features", "reporting.publisher.keyframe_event"):
        monkeypatch.setattr(f"slam.{name}", fail)
    monkeypatch.setattr("slam.graph.graph_estimate.residuals_of", fail)
    listener = Notices()
    run(drive, listener=listener)
    assert {type(event) for event in listener.events} == {ScanTracked}


def test_events_of_scans_are_not_built_if_no_sink_receives_them(
    drive: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Notices(EventRecorder):
        handled = (Notice,)

    class Unwanted(ScanTracked):
        def __new__(cls, *_: object, **__: object) -> NoReturn:
            raise AssertionError("an event was built that no sink receives")

    monkeypatch.setattr("slam.reporting.publisher.ScanTracked", Unwanted)
    assert len(run(drive[:60], listener=Notices()).poses)


def test_ground_truth_is_not_used(drive: list[Message], drive_result: Finished) -> None:
    assert run(without_ground_truth(drive)).poses.tobytes() == drive_result.poses.tobytes()


def test_scans_may_come_before_their_odometry(drive: list[Message], drive_result: Finished) -> None:
    messages = without_ground_truth(drive)
    late = sorted(messages, key=lambda message: message.stamp + (0.15 if isinstance(message, Odometry) else 0.0))
    assert run(late).poses.tobytes() == drive_result.poses.tobytes()


def test_without_scans_or_odometry_there_is_no_map(drive: list[Message]) -> None:
    with pytest.raises(MapError, match="no laser scan, so there is nothing to map"):
        run([])
    with pytest.raises(MapError, match="no laser scan, so there is nothing to map"):
        run(message for message in drive if isinstance(message, Odometry))
    with pytest.raises(MapError, match="scans, but no odometry"):
        run(message for message in drive if isinstance(message, Scan))


@pytest.mark.slow
def test_duplicate_messages_do_not_degrade_the_trajectory(drive: list[Message]) -> None:
    assert error(run(message for message in without_ground_truth(drive) for _ in range(2)), drive) < 0.01


@pytest.mark.parametrize("resolution", [pytest.param(0.25, marks=pytest.mark.slow), 1.0])
def test_stamps_may_be_coarser_than_scans_are_frequent(
    drive_with_frequent_scans: list[Message], result_with_frequent_scans: Finished, resolution: float
) -> None:
    """Ten scans of a second have the same stamp; they are different scans nevertheless."""
    messages = without_ground_truth(drive_with_frequent_scans)
    finished = run(replace(m, stamp=float(m.stamp // resolution * resolution)) for m in messages)  # type: ignore[type-var]
    assert len(np.unique(finished.stamps)) >= sum(isinstance(message, Scan) for message in messages)
    np.testing.assert_allclose(finished.poses[-1], result_with_frequent_scans.poses[-1], atol=0.1)


@pytest.mark.parametrize(
    "kind",
    [
        "no beams",
        "infinite",
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("no returns", "one beam", "behind the wall")),
    ],
)
def test_damaged_scans_do_not_degrade_the_trajectory(drive: list[Message], kind: str) -> None:
    def strange(scan: Scan) -> Scan:
        nothing = np.zeros(0)
        match kind:
            case "no returns":
                return replace(scan, ranges=np.full_like(scan.ranges, np.nan))
            case "infinite":
                return replace(scan, ranges=np.full_like(scan.ranges, np.inf))
            case "no beams":
                return replace(scan, ranges=nothing, angles=nothing, time_offsets=nothing)
            case "one beam":
                return replace(scan, ranges=np.ones(1), angles=np.zeros(1), time_offsets=np.zeros(1))
        return replace(scan, ranges=np.where(np.arange(len(scan.ranges)) % 7 == 0, 0.02, scan.ranges))

    count = 0
    messages: list[Message] = []
    for message in drive:
        if isinstance(message, Scan):
            count += 1
            message = strange(message) if count % 5 == 0 else message
        messages.append(message)
    finished = run(messages)
    assert error(finished, drive) < 0.012
    assert np.isfinite(finished.poses).all()


def test_a_run_of_empty_scans_is_bridged_by_odometry(drive_with_frequent_scans: list[Message]) -> None:
    drive = drive_with_frequent_scans
    messages = [
        replace(message, ranges=np.full_like(message.ranges, np.nan))
        if isinstance(message, Scan) and 6.0 < message.stamp < 7.5
        else message
        for message in drive
    ]
    listener = EventRecorder()
    finished = run(messages, listener=listener)
    assert error(finished, drive) < 0.03
    health = finished.summary["health"]
    assert isinstance(health, dict)
    assert health["empty_scans"] == 15
    (warning,) = [notice for notice in listener.of(Notice) if notice.level == "WARN"]
    assert warning.text.startswith("the scans showed nothing for 1.4 s: the lidar was covered")
    assert warning.stamp == pytest.approx(6.0, abs=0.15)


def test_with_empty_scans_only_the_trajectory_is_odometry(drive: list[Message]) -> None:
    messages = [
        replace(message, ranges=np.full_like(message.ranges, np.nan)) if isinstance(message, Scan) else message
        for message in without_ground_truth(drive)
    ]
    finished = run(messages)
    readings = [message for message in messages if isinstance(message, Odometry)]
    told = np.array([message.pose for message in readings])
    assert len(finished.walls) == len(finished.corners) == 0
    moved = se2.between(finished.poses[0], finished.poses)[np.isin(finished.stamps, [one.stamp for one in readings])]
    np.testing.assert_allclose(moved[:, :2], se2.between(told[0], told)[:, :2], atol=0.02)


@pytest.mark.parametrize(("first", "last", "where"), [(4.0, 20.0, "before the first"), (0.0, 8.0, "after the last")])
def test_a_path_without_scans_at_its_ends_is_a_warning(
    drive: list[Message], first: float, last: float, where: str
) -> None:
    """There the path is by odometry alone, however far the robot drives."""
    listener = EventRecorder()
    run([m for m in drive if not isinstance(m, Scan) or first <= m.stamp - drive[0].stamp <= last], listener=listener)
    (text,) = [notice.text for notice in listener.of(Notice) if notice.level == "WARN"]
    assert f"{where} scan the robot drives" in text


def test_the_number_of_beams_may_change(drive: list[Message]) -> None:
    messages: list[Message] = []
    for k, message in enumerate(drive):
        if isinstance(message, Scan):
            part = slice(None, None, 1 + k % 3)
            message = replace(
                message,
                ranges=message.ranges[part],
                angles=message.angles[part],
                time_offsets=message.time_offsets[part],
            )
        messages.append(message)
    assert error(run(messages), drive) < 0.012


def test_the_mount_may_be_configured() -> None:
    mount = (0.2, -0.1, 1.8)
    messages = list(Simulation("room", seed=3, duration=10.0, lidar=LidarModel(rate=5.0), mount=mount))
    unknown = [replace(message, mount=None) if isinstance(message, Scan) else message for message in messages]
    config = Config.model_validate({"lidar": {"mount": mount}})
    finished = run(unknown, config)
    assert finished.poses.tobytes() == run(messages).poses.tobytes()
    assert error(finished, messages) < 0.01


def test_map_and_pose_can_be_read_while_driving(drive: list[Message]) -> None:
    slam = Slam()
    assert len(slam.walls) == len(slam.corners) == 0
    np.testing.assert_array_equal(slam.pose, np.zeros(3))
    for message in drive:
        slam.add(message)
    assert len(slam.walls) >= 4
    assert np.isnan(slam.walls.covariance).all()
    pose = slam.pose
    pose[:] = 99.0
    assert np.abs(slam.pose).max() < 10.0
    assert slam.keyframe_covariance(3).shape == (3, 3)
    for index in (-1, 1000):
        with pytest.raises(MapError, match=f"there is no keyframe {index}: the map has "):
            slam.keyframe_covariance(index)


class ForbiddenSearch(LoopAgreement):
    """Loop search that must not be used."""

    def search(self, mapper: Mapper, local_field: LocalField, among: object = None, *, ended: bool = False) -> NoReturn:
        raise AssertionError("searched for a loop")


def test_loop_closure_can_be_switched_off(drive: list[Message]) -> None:
    off = Config.model_validate({"loop_closure": {"enabled": False}})
    for config in (Config(), off):
        slam = Slam(config, loops=ForbiddenSearch())
        with nullcontext() if config is off else pytest.raises(AssertionError, match="searched for a loop"):
            for message in drive:
                slam.add(message)


class UndecidedSearch(LoopAgreement):
    """Loop search that still follows a hypothesis when the run ends."""

    def take_rejected(self, *, ended: bool = False) -> list[LoopDecision]:
        return [self.number(undecided(2))] if ended else []


def undecided(keyframe: int) -> LoopDecision:
    match, none = LoopMatch(keyframe, 0, np.zeros(3), np.eye(3), 6.0, 0.9, 0.9), np.zeros((0, 2))
    return LoopDecision(
        0, keyframe, 0, np.zeros(3), np.zeros(3), LoopStatus.REJECTED, "too few looks", (match,),
        0.0, 0.0, (), 0, (none, none),
    )  # fmt: skip


@pytest.mark.parametrize("queued", [False, True])
def test_a_loop_that_is_rejected_as_the_run_ends_has_its_number_in_the_session(
    drive: list[Message], queued: bool
) -> None:
    """So `wclm correct --close` finds it, and no loop of a run that continues the session gets the same number."""
    last = max(k for k, message in enumerate(drive) if isinstance(message, Scan if queued else Odometry))
    slam = Slam(loops=UndecidedSearch())
    for message in drive[: last + 1]:
        slam.add(message)
    finished, session = slam.finish(), slam.session
    assert bool(session.queued_scans) == queued
    assert session.loop_decisions == finished.summary["loop_decisions"]
    assert [row["candidate"] for row in session.loop_decisions] == [1]
    assert session.slam_state.loops.number(undecided(2)).candidate == 2


def test_keyframes_are_as_far_apart_as_configured(drive: list[Message], drive_result: Finished) -> None:
    wide = Config.model_validate({"mapping": {"keyframe_distance": 1.5, "keyframe_turn": 1.0}})
    finished = run(drive, wide)
    assert len(finished.keyframes) < 0.6 * len(drive_result.keyframes)
    assert error(finished, drive) < 0.012


def test_the_session_is_available_after_finish_only() -> None:
    with pytest.raises(SlamError, match="after finish"):
        _ = Slam().session


@pytest.mark.parametrize(
    "sigma", [pytest.param(0.03, marks=pytest.mark.slow), pytest.param(0.05, marks=pytest.mark.slow), 0.099999]
)
def test_the_largest_bearing_noise_that_can_be_set_still_gives_a_trajectory(sigma: float) -> None:
    messages = list(Simulation("room", seed=3, duration=6.0))
    assert error(run(messages, Config.model_validate({"lidar": {"sigma_bearing": sigma}})), messages) < 0.012


@pytest.mark.parametrize(
    "reading", [*(pytest.param(reading, marks=pytest.mark.slow) for reading in (5.0, 6.0, -1.0)), 0.0, np.inf]
)
def test_readings_outside_the_stated_limits_are_no_returns(reading: float) -> None:
    """Whatever stands for a no-return, also the stated greatest range, the map is that of NaN."""

    def marked(message: Message) -> Message:
        if not isinstance(message, Scan):
            return message
        return replace(message, ranges=np.where(np.isnan(message.ranges), reading, message.ranges))

    messages = list(Simulation("square", seed=1, duration=8.0, lidar=LidarModel(beams=180, rate=5.0, range_max=5.0)))
    expected, found = run(messages), run([marked(message) for message in messages])
    np.testing.assert_array_equal(found.poses, expected.poses)
    assert len(found.walls) == len(expected.walls)

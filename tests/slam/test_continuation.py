"""Sessions can be continued: after an interruption, from anywhere in the map, or with the map frozen."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.config import Config, LidarConfig, config_to_toml
from slam.errors import MapError, MessageError
from slam.evaluation.metrics import align
from slam.events import EventRecorder, Finished, GraphInspected, Notice
from slam.graph.isam2 import IncrementalSolver
from slam.io.output_dir import CONFIG, SESSION
from slam.io.run_results import read_run_results, write_results
from slam.io.sessions import Recording, read_session, write_session
from slam.io.sessions.session import HEADER
from slam.io.tum import Trajectory
from slam.localisation.state import LocalisationStatus
from slam.odometry.continuity import RESTARTED
from slam.offline.optimisation import optimise

from .earlier_sessions import remove_odometry_stamps

DRIVEN, INTERRUPTED = 22.0, 12.0  # seconds of the first drive
LATER = 1000.0  # seconds until the next


def drive(world: str, seed: int, begin: float, end: float, shift: float = 0.0) -> list[Message]:
    """Return the messages between two times after the start of a simulated drive."""
    messages = list(Simulation(world, seed=seed, duration=end, lidar=LidarModel(beams=180, rate=5.0)))
    return [
        replace(message, stamp=message.stamp + shift)
        for message in messages
        if message.stamp - messages[0].stamp > begin
    ]


def run(messages: Sequence[Message], left: Path | None = None, *, frozen: bool = False) -> tuple[Slam, Finished, list]:
    listener = EventRecorder()
    resumed = None if left is None else read_session(left, solve=False)
    slam = Slam(sinks=[listener], resumed=resumed, frozen=frozen)
    for message in messages:
        slam.add(message)
    return slam, slam.finish(), [notice.text for notice in listener.of(Notice)]


def leave(slam: Slam, directory: Path) -> Path:
    directory.mkdir()
    (directory / CONFIG).write_text(config_to_toml(Config()))
    write_session(directory, slam.session)
    return directory


def test_a_continued_run_has_the_settings_of_the_session_unless_others_are_given() -> None:
    messages = drive("room", 1, 0.0, 2.0)
    own, found = Config(lidar=LidarConfig(range_max=5.0)), (0.1, 0.0, 3.0)
    slam = Slam(own)
    for message in messages:
        slam.add(message)
    slam.finish()
    assert Slam(resumed=slam.session.copy()).config == own
    assert Slam(Config(), resumed=slam.session.copy()).config == Config()
    session = slam.session.copy()  # a mount that was found is in no settings
    session.recordings.append(Recording(name="a", path=None, first=0.0, last=2.0, settings=own.with_mount(found)))
    assert Slam(resumed=session).config == own.with_mount(found)


@pytest.fixture(scope="module")
def first() -> list[Message]:
    return drive("office", 1, 0.0, DRIVEN)


@pytest.fixture(scope="module")
def mapped(first: list[Message], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Finished]:
    slam, finished, _ = run(first)
    return leave(slam, tmp_path_factory.mktemp("run") / "out"), finished


@pytest.fixture(scope="module")
def interrupted(first: list[Message], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the directory of a run that was interrupted in the first drive."""
    cut = first[0].stamp + INTERRUPTED
    slam, _, _ = run([message for message in first if message.stamp < cut])
    return leave(slam, tmp_path_factory.mktemp("interrupted") / "left")


def error(finished: Finished, messages: Sequence[Message], like: Finished, first: Sequence[Message]) -> float:
    """Return the RMS distance from the true positions after aligning `like` with those of `first`."""
    there = aligned(like, first)
    poses, truth = at_truth(finished, messages)
    return float(np.sqrt(np.mean(np.sum((se2.compose(there, poses)[:, :2] - truth[:, :2]) ** 2, axis=1))))


def aligned(finished: Finished, messages: Sequence[Message]) -> se2.Pose:
    poses, truth = at_truth(finished, messages)
    return align(poses[:, :2], truth[:, :2])


def at_truth(finished: Finished, messages: Sequence[Message]) -> tuple[np.ndarray, np.ndarray]:
    true = [message for message in messages if isinstance(message, GroundTruth)]
    truth = Trajectory(np.array([m.stamp for m in true]), np.array([m.pose for m in true]))
    looked = truth.at(finished.stamps)
    assert looked.covered.any()
    return finished.poses[looked.covered], looked.poses[looked.covered]


def test_a_continued_run_equals_an_uninterrupted_one(
    first: list[Message], mapped: tuple[Path, Finished], interrupted: Path
) -> None:
    _, uninterrupted = mapped
    cut = first[0].stamp + INTERRUPTED
    slam, finished, notices = run([message for message in first if message.stamp >= cut], interrupted)
    assert not notices
    np.testing.assert_array_equal(finished.stamps, uninterrupted.stamps)
    apart = np.hypot(*(finished.poses - uninterrupted.poses)[:, :2].T)
    assert apart.max() < 1e-6
    assert np.abs(se2.wrap(finished.poses[:, 2] - uninterrupted.poses[:, 2])).max() < 1e-6
    assert len(finished.walls) == len(uninterrupted.walls)
    assert slam.session.starts == [0]


def test_a_run_of_an_earlier_version_continues(
    first: list[Message], mapped: tuple[Path, Finished], interrupted: Path, tmp_path: Path
) -> None:
    """It has not kept the stamps of the readings of odometry at the last fix and keyframe."""
    _, uninterrupted = mapped
    cut = first[0].stamp + INTERRUPTED
    left = tmp_path / "left"
    shutil.copytree(interrupted, left)
    header = left / SESSION / HEADER
    data = json.loads(header.read_text())
    remove_odometry_stamps(data["checkpoint"])
    header.write_text(json.dumps(data))
    slam, finished, notices = run([message for message in first if message.stamp >= cut], left)
    assert not notices
    np.testing.assert_array_equal(finished.stamps, uninterrupted.stamps)
    apart = np.hypot(*(finished.poses - uninterrupted.poses)[:, :2].T)
    assert apart.max() < 0.01
    assert len(finished.walls) == len(uninterrupted.walls)
    assert slam.session.starts == [0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lidar", "interrupted"),
    [
        pytest.param(LidarModel(beams=180, rate=5.0), 9.0, id="while the noise is learned"),
        pytest.param(LidarModel(beams=360, rate=5.0, range_max=15.0), 9.0, id="before walls are linearised again"),
    ],
)
def test_the_continuation_of_a_run_does_not_depend_on_when_it_was_interrupted(
    lidar: LidarModel, interrupted: float, tmp_path: Path
) -> None:
    messages = list(Simulation("office", seed=2, duration=20.0, lidar=lidar))
    cut, snapshot, whole = messages[0].stamp + interrupted, None, Slam()
    for message in messages:
        if snapshot is None and message.stamp >= cut:
            snapshot = whole.snapshot()
        whole.add(message)
    assert snapshot is not None
    (tmp_path / CONFIG).write_text(config_to_toml(Config()))
    write_session(tmp_path, snapshot.session)
    _, finished, _ = run([message for message in messages if message.stamp >= cut], tmp_path)
    np.testing.assert_allclose(finished.poses, whole.finish().poses, atol=1e-6)


def test_a_state_is_saved_without_isam2(first: list[Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While it is saved, a copy would keep all the parts that the run replaces in its own one."""
    slam = Slam()
    for message in first[: len(first) // 2]:
        slam.add(message)
    snapshot = slam.snapshot()
    monkeypatch.setattr(IncrementalSolver, "isam", property(lambda solver: pytest.fail("iSAM2 is needed")))
    write_results(tmp_path, snapshot.finished(), Config(), snapshot.summary)
    write_session(tmp_path, snapshot.session)


def test_a_saved_state_can_be_continued_and_does_not_change_the_run(
    first: list[Message], mapped: tuple[Path, Finished], tmp_path: Path
) -> None:
    _, uninterrupted = mapped
    cut = first[0].stamp + INTERRUPTED
    slam = Slam()
    with pytest.raises(MapError, match="nothing is mapped yet"):
        slam.snapshot()
    for message in first:
        if message.stamp >= cut and not (tmp_path / "saved").exists():
            snapshot = slam.snapshot()
            (tmp_path / "saved").mkdir()
        slam.add(message)
    finished = slam.finish()
    np.testing.assert_array_equal(finished.poses, uninterrupted.poses)
    saved = tmp_path / "saved"  # only now: later messages must not have changed the snapshot
    write_results(saved, snapshot.finished(), Config(), snapshot.summary)
    write_session(saved, snapshot.session)
    stamps = read_run_results(saved).trajectory.stamps
    assert stamps[-1] < cut
    assert len(stamps) == len(snapshot.session.scans)  # those between the scans are left out, to save quickly
    _, finished, _ = run([message for message in first if message.stamp >= cut], saved)
    np.testing.assert_array_equal(finished.stamps, uninterrupted.stamps)
    assert np.hypot(*(finished.poses - uninterrupted.poses)[:, :2].T).max() < 1e-6


@pytest.mark.slow
def test_keeping_all_features_does_not_change_the_result() -> None:
    """`wclm run` keeps them, `wclm live` does not; the trajectories are identical."""
    runs, laps = [], list(Simulation("room", seed=1, duration=80.0, lidar=LidarModel(beams=180, rate=2.5)))  # two
    for keep_all_features in (False, True):
        slam = Slam(keep_all_features=keep_all_features)
        for message in laps:
            slam.add(message)
        runs.append((slam.finish(), slam.session.scan_history().has_features))
    (first, some), (second, every) = runs
    assert every.all()
    assert not some.all()
    np.testing.assert_array_equal(first.poses, second.poses)


def test_a_run_from_an_unknown_place_is_relocalised_and_extends_the_map(
    first: list[Message], mapped: tuple[Path, Finished], tmp_path: Path
) -> None:
    left, before = mapped
    second = drive("office", 2, 20.0, 40.0, LATER)
    slam, finished, notices = run(second, left)
    assert notices == ["relocalised in the map"]
    assert len(finished.walls) > len(before.walls)
    assert len(finished.keyframes) > len(before.keyframes)
    assert error(finished, first, finished, first) < 0.01
    assert error(finished, second, finished, first) < 0.01
    session = slam.session
    assert session.starts == [0, len(read_session(left).scans)]
    drives = session.scan_history()
    assert session.starts[1] in drives.kidnapped
    poses = drives.scan_poses(finished.keyframes.poses)  # of all scans, also those before the relocalisation
    there = aligned(finished, second)
    rows = [k for k, scan in enumerate(session.scans) if scan.stamp > LATER]
    truth = at_truth(replace(finished, stamps=drives.stamps[rows], poses=poses[rows]), second)
    assert np.hypot(*(se2.compose(there, truth[0]) - truth[1])[:, :2].T).max() < 0.05
    again = read_session(leave(slam, tmp_path / "both"))
    assert again.starts == session.starts
    assert [len(history) for history in again.odometry] == [len(history) for history in session.odometry]


def started_again(messages: Sequence[Message], stamp: float) -> list[Message]:
    """Return messages from a stamp (seconds) on whose odometry counts from zero, as that of a base started again."""
    zero = next(message.pose for message in messages if isinstance(message, Odometry))
    later = stamp - messages[0].stamp
    moved = [replace(message, stamp=message.stamp + later) for message in messages]
    return [
        replace(message, pose=se2.between(zero, message.pose)) if isinstance(message, Odometry) else message
        for message in moved
    ]


@pytest.mark.parametrize("pause", [5.0, pytest.param(50.0, marks=pytest.mark.slow)])
def test_a_robot_that_stood_while_the_program_was_restarted_is_soon_placed_where_it_was(
    first: list[Message], mapped: tuple[Path, Finished], interrupted: Path, pause: float
) -> None:
    """Odometry of devices counts from zero in each run of the program."""
    cut = first[0].stamp + INTERRUPTED
    second = started_again([message for message in first if message.stamp >= cut], cut + pause)
    _, finished, notices = run(second, interrupted)
    assert notices == [RESTARTED, "the scans fit where the robot was expected in the map"]
    ((begin, end),) = finished.summary["lost"]
    assert end - begin < 3.0
    assert error(finished, second, mapped[1], first) < 0.02


@pytest.mark.parametrize(
    ("world", "begin", "known"),
    [("office", 2.0, True), pytest.param("museum", 22.0, False, marks=pytest.mark.slow)],
)
def test_a_robot_that_drove_while_the_program_was_restarted_is_lost_until_it_is_recognised(
    world: str, begin: float, known: bool, tmp_path: Path
) -> None:
    """In the museum the first scans of the second drive would fit where the robot was, too."""
    first = drive(world, 1, 0.0, 15.0)
    while not isinstance(first[-1], Scan):
        first.pop()
    slam, _, _ = run(first)
    assert slam.session.queued_scans  # it is tracked, but says nothing of where the second drive begins
    left = leave(slam, tmp_path / "left")
    second = started_again(drive(world, 1, begin, begin + 12.0), first[-1].stamp + 40.0)
    slam, _, notices = run(second, left)
    assert RESTARTED in notices
    if not known:
        assert len(slam.slam_state.mapper.landmarks.parts.firsts) == 2  # both drives are kept, not connected
        with pytest.raises(MapError, match="never relocalised in the map of the session"):
            run(second, left, frozen=True)
    assert ("relocalised in the map" in notices) is known
    assert (slam.state.status is LocalisationStatus.LOST) is not known


@pytest.mark.slow
def test_on_a_frozen_map_only_the_trajectory_is_new(first: list[Message], mapped: tuple[Path, Finished]) -> None:
    left, before = mapped
    second = drive("office", 2, 12.0, 24.0, LATER)
    _, finished, notices = run(second, left, frozen=True)
    assert notices == ["relocalised in the map"]
    for name in ("frame", "covariance", "low", "high", "observations"):
        np.testing.assert_allclose(getattr(finished.walls, name), getattr(before.walls, name), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(finished.keyframes.poses, before.keyframes.poses, atol=1e-6)
    assert finished.stamps[0] > LATER
    assert error(finished, second, before, first) < 0.01


@pytest.mark.slow
def test_an_optimised_session_publishes_its_map_and_residuals(mapped: tuple[Path, Finished]) -> None:
    listener = EventRecorder()
    optimised = optimise(read_session(mapped[0]), [listener])
    inspected, finished = listener.events[-2:]
    assert isinstance(inspected, GraphInspected)
    assert len(inspected.residuals.squared) == optimised.session.slam_state.mapper.graph.factor_count
    assert finished is optimised.finished


@pytest.mark.parametrize("frozen", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_continuation_without_scans_is_an_error(mapped: tuple[Path, Finished], frozen: bool) -> None:
    left, _ = mapped
    second = [m for m in drive("office", 2, 0.0, 1.0, LATER) if not isinstance(m, Scan)]
    for messages, missing in (([], "no laser scan"), (second, "no laser scan")):
        with pytest.raises(MapError, match=missing):
            run(messages, left, frozen=frozen)


@pytest.mark.slow
def test_a_robot_that_ends_lost_on_a_frozen_map_keeps_its_trajectory(mapped: tuple[Path, Finished]) -> None:
    """It is relocalised, then kidnapped to another building."""
    left, before = mapped
    there = drive("office", 2, 12.0, 18.0, LATER)
    elsewhere = drive("room", 3, 0.0, 5.0, there[-1].stamp + 10.0)
    _, finished, notices = run([*there, *elsewhere], left, frozen=True)
    assert notices[0] == "relocalised in the map"
    known = finished.stamps < there[-1].stamp
    poses = replace(finished, stamps=finished.stamps[known], poses=finished.poses[known])
    assert error(poses, there, poses, there) < 0.02
    assert len(finished.walls) == len(before.walls)


@pytest.mark.slow
def test_a_run_in_another_building_is_mapped_alone(mapped: tuple[Path, Finished]) -> None:
    left, _ = mapped
    elsewhere = drive("room", 3, 0.0, 6.0, LATER)
    slam, finished, notices = run(elsewhere, left)
    assert len(notices) == 1
    assert "left out of the results" in notices[0]
    assert finished.stamps[0] >= LATER
    assert slam.session.starts == [0]
    assert all(scan.stamp >= LATER for scan in slam.session.scans)
    assert error(finished, elsewhere, finished, elsewhere) < 0.02
    with pytest.raises(MapError, match="never relocalised in the map"):
        run(elsewhere, left, frozen=True)


def test_a_drive_from_before_the_last_odometry_of_the_session_is_refused_in_its_frozen_map(
    first: list[Message], mapped: tuple[Path, Finished]
) -> None:
    """It would have no trajectory. A drive that begins more than a second before is refused at its first message."""
    session = read_session(mapped[0])
    session.odometry[-1].add(Odometry(LATER + 0.99, session.odometry[-1].poses[-1]))
    slam = Slam(resumed=session, frozen=True, start=np.zeros(3))
    for message in first:
        if message.stamp < 0.7:
            slam.add(replace(message, stamp=message.stamp + LATER))
    with pytest.raises(MessageError, match=r"ends at 1000\.990 s; add a constant to all stamps"):
        slam.add(replace(first[-1], stamp=LATER - 0.2))
    with pytest.raises(MapError, match="no measurement is later than those of the session whose map is used"):
        slam.finish()

"""Odometry that jumps farther than any robot can move, or starts again at zero, goes on from where it was."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Message, Odometry
from drivers.simulation import LidarModel, Simulation, load_world
from slam import Slam
from slam.config import Config, config_to_toml
from slam.io.output_dir import CONFIG
from slam.io.sessions import read_session, write_session
from slam.localisation.state import LocalisationStatus
from slam.odometry.continuity import JUMPED, RESTARTED, ContinuousOdometry
from slam.reporting.notice_collector import NoticeCollector
from slam.visualisation.report_page.findings import group_warnings

FAR = np.array([200.0, -1e8, 1.0])


def mapped(messages: Sequence[Message], notices: NoticeCollector) -> Slam:
    """Return a finished run with these messages."""
    slam = Slam(sinks=[notices])
    for message in messages:
        slam.add(message)
    slam.finish()
    return slam


def readings(poses: Sequence[Sequence[float]]) -> list[Odometry]:
    """Return readings every tenth of a second."""
    return [Odometry(0.1 * k, np.array(pose)) for k, pose in enumerate(poses)]


def test_readings_without_a_jump_are_left_as_they_are() -> None:
    source = ContinuousOdometry()
    for reading in readings([[0, 0, 0], [2, 0, 0], [2, 2, 3], [0, 0.5, -3]]):
        assert source.continued(reading) is reading
    later = Odometry(100.0, np.array([500.0, 0.0, 0.0]))  # driven in a gap
    assert source.continued(later) is later


def test_a_motion_of_kilometres_in_a_gap_is_a_jump() -> None:
    source = ContinuousOdometry()
    source.continued(Odometry(0.0, np.zeros(3)))
    np.testing.assert_array_equal(source.continued(Odometry(1000.0, np.array([5e3, 0.0, 0.0]))).pose, np.zeros(3))
    assert source.jump == JUMPED


def test_a_run_within_a_minute_goes_on_from_the_last_pose_of_the_earlier_one_if_its_odometry_starts_at_zero() -> None:
    last = Odometry(100.0, np.array([4.0, 8.0, 2.5]))
    source, motion = ContinuousOdometry(last), np.array([0.1, 0.0, 0.2])
    np.testing.assert_array_equal(source.continued(Odometry(140.0, np.zeros(3))).pose, last.pose)
    assert source.jump == RESTARTED
    np.testing.assert_allclose(source.continued(Odometry(140.1, motion)).pose, se2.compose(last.pose, motion))
    assert source.jump is None


@pytest.mark.parametrize(
    "reading",
    [
        pytest.param(Odometry(100.1, np.array([4.01, 8.0, 2.5])), id="the base has counted on"),
        pytest.param(Odometry(161.0, np.zeros(3)), id="the robot may have been anywhere for longer than a minute"),
    ],
)
def test_the_first_reading_of_other_runs_is_left_as_it_is(reading: Odometry) -> None:
    source = ContinuousOdometry(Odometry(100.0, np.array([4.0, 8.0, 2.5])))
    assert source.continued(reading) is reading
    assert source.jump is None


@pytest.mark.parametrize("distance", [5.0, -5.0])
def test_a_motion_of_metres_within_a_reading_is_a_jump(distance: float) -> None:
    """As of a counter that overflows: along a bare corridor no scan contradicts it."""
    source = ContinuousOdometry()
    read = [[0.02 * k + distance * (k >= 5), 0.0, 0.0] for k in range(9)]
    used = np.array([source.continued(Odometry(0.02 * k, np.array(pose))).pose[0] for k, pose in enumerate(read)])
    np.testing.assert_allclose(used, [0.0, 0.02, 0.04, 0.06, 0.08, 0.08, 0.10, 0.12, 0.14], atol=1e-12)


def test_readings_that_arrive_in_bursts_are_no_jumps() -> None:
    """Two seconds of driving at 2 m/s lie between readings that are stamped at the same time when they arrive."""
    source = ContinuousOdometry()
    for k in range(12):
        reading = Odometry(8.0 * ((k + 3) // 4), np.array([4.0 * k, 0.0, 0.0]))
        assert source.continued(reading) is reading


def test_motions_after_a_jump_are_those_of_the_readings() -> None:
    source = ContinuousOdometry()
    driven = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.2], [0.2, 0.1, 0.4], [0.3, 0.2, 0.5]])
    read = [*driven[:2], *se2.compose(FAR, driven[2:])]
    poses = [source.continued(reading).pose for reading in readings(read)]
    np.testing.assert_array_equal(poses[2], poses[1])
    np.testing.assert_allclose(se2.between(poses[2], poses[3]), se2.between(driven[2], driven[3]), atol=1e-6)


def test_a_base_that_starts_again_goes_on_from_where_it_was() -> None:
    source = ContinuousOdometry()
    driven = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.2], [0.9, 0.3, 0.4]]
    poses = [source.continued(reading).pose for reading in readings([*driven, [0, 1e-16, -0.0]])]
    np.testing.assert_array_equal(poses[3], driven[2])
    assert source.jump == RESTARTED
    after = source.continued(Odometry(0.4, np.array([0.2, 0.0, 0.1]))).pose
    np.testing.assert_allclose(se2.between(poses[3], after), [0.2, 0.0, 0.1], atol=1e-12)
    assert source.jump is None


@pytest.mark.parametrize("damaged", [FAR, np.zeros(3)])
@pytest.mark.parametrize("count", [1, 5])
def test_damaged_readings_do_not_change_the_ones_after_them(damaged: se2.Pose, count: int) -> None:
    source = ContinuousOdometry()
    driven = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.2], [1.0, 0.1, 0.3], [1.5, 0.2, 0.4]])
    read = [*driven[:2], *[damaged] * count, *driven[2:]]
    used = [source.continued(reading).pose for reading in readings(read)]
    np.testing.assert_allclose(used[2 : 2 + count], np.tile(driven[1], (count, 1)), atol=1e-12)
    np.testing.assert_allclose(used[2 + count :], driven[2:], atol=1e-12)


@pytest.mark.parametrize(
    "jumps",
    [
        pytest.param(lambda k: k == 50, marks=pytest.mark.slow),
        lambda k: k >= 50,
        pytest.param(lambda k: k % 20 == 0, marks=pytest.mark.slow),
    ],
)
def test_a_map_is_that_of_a_drive_without_jumps(tmp_path: Path, jumps: Callable[[int], bool]) -> None:
    drive = list(Simulation("room", seed=3, duration=5.0, lidar=LidarModel(beams=180, rate=5.0)))
    count, spoiled, stamps, before = 0, list[Message](), [], False
    for message in drive:
        count += isinstance(message, Odometry)
        far = isinstance(message, Odometry) and jumps(count)
        spoiled.append(replace(message, pose=se2.compose(FAR, message.pose)) if far else message)
        if isinstance(message, Odometry):
            stamps += [message.stamp] if far != before else []
            before = far
    notices, usual = NoticeCollector(), NoticeCollector()
    slam = mapped(spoiled, notices)
    np.testing.assert_allclose(slam.pose, mapped(drive, usual).pose, atol=0.01)
    assert group_warnings(notices.texts)[JUMPED] == pytest.approx(stamps, abs=0.005)
    assert JUMPED not in group_warnings(usual.texts)
    (tmp_path / CONFIG).write_text(config_to_toml(Config()))
    write_session(tmp_path, slam.session)
    assert read_session(tmp_path).slam_state.mapper.keyframe_count > 1


def test_a_robot_that_was_carried_while_its_base_was_off_is_lost() -> None:
    room, lidar = load_world("room"), LidarModel(beams=180, rate=5.0)
    elsewhere = replace(room, waypoints=room.waypoints[2:0:-1])
    first = Simulation(room, seed=3, duration=5.0, lidar=lidar)
    second = Simulation(elsewhere, seed=4, duration=2.0, lidar=lidar)
    notices = NoticeCollector()
    slam = mapped([*first, *(replace(message, stamp=message.stamp + 60.0) for message in second)], notices)
    assert slam.state.status is LocalisationStatus.LOST
    assert group_warnings(notices.texts)[RESTARTED] == [60.0]

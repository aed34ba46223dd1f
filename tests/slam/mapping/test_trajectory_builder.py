"""Trajectory: odometry between the scans, and the scans moving with their keyframes."""

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry
from slam.mapping.trajectory_builder import TrajectoryBuilder
from slam.odometry.history import OdometryHistory

from ..odometry.circle import SPEED, TURN_RATE, circle_history, pose_on_circle


def test_the_trajectory_passes_through_the_scans_without_jumps() -> None:
    odometry, random = circle_history(100, 0.04), np.random.default_rng(1)
    trajectory, keyframes = TrajectoryBuilder(), []
    stamps = np.arange(0.111, 3.5, 0.25)
    for k, stamp in enumerate(stamps):  # odometry drifts, in a frame of its own
        true = se2.compose([5.0, -2.0, 2.5], pose_on_circle(stamp) + np.array([0.02 * stamp, 0.0, 0.01 * stamp]))
        keyframes.append(se2.compose(true, random.normal(0, 0.1, 3)))
        trajectory.add(float(stamp), k, se2.between(keyframes[k], true), np.eye(3))
    at, poses = trajectory.path(np.array(keyframes), odometry)
    scan_stamps, scan_poses = trajectory.at_scans(np.array(keyframes))
    np.testing.assert_array_equal(at, np.sort(np.concatenate([odometry.stamps, scan_stamps])))
    at_scans = poses[np.isin(at, scan_stamps)]
    np.testing.assert_allclose(at_scans[:, :2], scan_poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(se2.wrap(at_scans[:, 2] - scan_poses[:, 2]), 0.0, atol=1e-9)
    headings = np.unwrap(poses[:, 2])
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() < 1.5 * SPEED * 0.04
    assert np.abs(np.diff(headings)).max() < 1.5 * TURN_RATE * 0.04


def test_the_path_does_not_depend_on_the_blocks_in_which_it_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    odometry, random, trajectory = circle_history(100, 0.04), np.random.default_rng(1), TrajectoryBuilder()
    for k, stamp in enumerate(np.arange(0.111, 3.5, 0.25)):
        trajectory.add(float(stamp), k, random.normal(0, 1, 3), np.eye(3))
    keyframes = random.normal(0, 1, (20, 3))
    at, poses = trajectory.path(keyframes, odometry)
    monkeypatch.setattr("slam.mapping.trajectory_builder.BLOCK", 7)
    in_blocks = trajectory.path(keyframes, odometry)
    np.testing.assert_array_equal(in_blocks[0], at)
    np.testing.assert_allclose(in_blocks[1], poses, atol=1e-12)


def test_the_error_of_odometry_is_distributed_over_the_wheel_travel() -> None:
    odometry, trajectory = OdometryHistory(), TrajectoryBuilder()
    for k in range(21):  # stands for a second, then drives at 0.5 m/s
        odometry.add(Odometry(0.1 * k, np.array([max(0.0, 0.05 * (k - 10)), 0.0, 0.0])))
    trajectory.add(0.0, 0, np.zeros(3), np.eye(3))
    trajectory.add(2.0, 0, np.array([0.6, 0.0, 0.2]), np.eye(3))
    _, poses = trajectory.path(np.zeros((1, 3)), odometry)
    np.testing.assert_allclose(poses[:11], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(poses[10:], axis=0), np.tile([0.06, 0.0, 0.02], (10, 1)), atol=1e-12)


def test_the_motion_is_even_between_scans_if_the_wheels_stand_still() -> None:
    """The robot is carried, or odometry fails: it does not jump at the next scan."""
    odometry, trajectory = (
        OdometryHistory.from_arrays(np.linspace(0.0, 2.0, 21), np.zeros((21, 3))),
        TrajectoryBuilder(),
    )
    for stamp, x in ((0.0, 0.0), (1.0, 0.5), (2.0, 1.5)):
        trajectory.add(stamp, 0, np.array([x, 0.0, 0.0]), np.eye(3))
    at, poses = trajectory.path(np.zeros((1, 3)), odometry)
    np.testing.assert_allclose(poses[:, 0], np.interp(at, [0.0, 1.0, 2.0], [0.0, 0.5, 1.5]), atol=1e-12)


def test_a_single_scan_places_all_readings() -> None:
    odometry, trajectory = circle_history(), TrajectoryBuilder()
    trajectory.add(0.55, 0, np.array([1.0, 0.0, 0.0]), np.eye(3))
    _, poses = trajectory.path(np.array([[1.0, 1.0, np.pi / 2]]), odometry)
    there = se2.compose([1.0, 2.0, np.pi / 2], se2.between(odometry.at(0.55), odometry.at(0.0)))
    np.testing.assert_allclose(poses[0], there, atol=1e-9)
    assert len(poses) == 21


def test_a_scan_at_the_stamp_of_a_reading_adds_no_pose() -> None:
    odometry, trajectory = circle_history(), TrajectoryBuilder()
    stamp = float(odometry.stamps[3])
    trajectory.add(stamp + 1e-9, 0, np.zeros(3), np.eye(3))  # the same but for rounding
    at, _ = trajectory.path(np.zeros((1, 3)), odometry)
    np.testing.assert_array_equal(at, odometry.stamps)


def test_a_scan_before_the_first_reading_is_on_the_path() -> None:
    odometry, trajectory = circle_history(), TrajectoryBuilder()
    first = float(odometry.stamps[0])
    for stamp in (first - 0.15, first + 0.5):
        trajectory.add(stamp, 0, np.array([1.0, 0.0, 0.0]), np.eye(3))
    at, poses = trajectory.path(np.zeros((1, 3)), odometry)
    assert at[0] == first - 0.15
    np.testing.assert_allclose(poses[0], [1.0, 0.0, 0.0], atol=1e-12)

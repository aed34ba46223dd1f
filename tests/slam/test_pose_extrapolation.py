"""The pose extrapolated by odometry: accurate, with a consistent covariance, and without effect on the estimate."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.special import chdtri

import drivers
from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan, end_stamp
from slam import Slam
from slam.events import KeyframeAdded, ScanTracked, StateChanged
from slam.localisation.state import LocalisationStatus
from slam.odometry.velocity import STEADY_SECONDS, VelocityFilter
from slam.pose_extrapolation import ExtrapolatedPose, PoseExtrapolator

WORLD = "sim:office?duration=12&lidar=short"


def messages() -> list[Message]:
    return list(drivers.open(WORLD))


def as_they_arrive(ordered: list[Message]) -> Iterator[Message]:
    """Yield messages in the order of their ends, scans up to 40 ms late, as devices deliver them."""
    random = np.random.default_rng(3)
    arrivals = [end_stamp(message) + 0.04 * random.random() * isinstance(message, Scan) for message in ordered]
    yield from (ordered[k] for k in np.argsort(arrivals, kind="stable"))


@pytest.fixture(scope="module")
def extrapolated() -> tuple[list[ExtrapolatedPose], dict[float, se2.Pose], bytes]:
    """Poses extrapolated during a run on messages as they arrive, the true ones, and the trajectory."""
    extrapolator = PoseExtrapolator()
    slam, poses, truth = Slam(sinks=[extrapolator]), [], {}
    for message in as_they_arrive(messages()):
        if isinstance(message, GroundTruth):
            truth[message.stamp] = message.pose
        elif isinstance(message, Odometry) and (pose := extrapolator.at(message)) is not None:
            poses.append(pose)
        slam.add(message)
    return poses, truth, slam.finish().poses.tobytes()


@pytest.mark.slow
def test_the_estimate_does_not_depend_on_the_order_of_arrival(
    extrapolated: tuple[list[ExtrapolatedPose], dict[float, se2.Pose], bytes],
) -> None:
    slam = Slam()
    for message in messages():
        slam.add(message)
    assert slam.finish().poses.tobytes() == extrapolated[2]


def test_poses_are_accurate_and_their_covariances_consistent(
    extrapolated: tuple[list[ExtrapolatedPose], dict[float, se2.Pose], bytes],
) -> None:
    poses, truth, _ = extrapolated
    origin = truth[min(truth)]
    errors = [se2.between(se2.between(origin, truth[pose.stamp]), pose.pose) for pose in poses if pose.stamp in truth]
    known = [pose for pose in poses if pose.stamp in truth]
    assert len(known) > 200
    assert np.hypot(*np.array(errors)[:, :2].T).max() < 0.05
    assert np.abs(np.array(errors)[:, 2]).max() < 0.02
    nees = [error @ np.linalg.solve(pose.covariance, error) for error, pose in zip(errors, known, strict=True)]
    assert np.mean(np.array(nees) < chdtri(3, 0.001)) > 0.95


def reading(stamp: float, *pose: float) -> Odometry:
    return Odometry(stamp, np.array(pose))


def test_turns_add_up_while_scans_are_missing() -> None:
    """Of wheels that measure turns a quarter too large, during one and a half turns to either side."""
    model = Slam().slam_state.odometry_model
    for _ in range(500):
        model.add_motion(np.array([0.0, 0.0, 0.25]), np.array([0.0, 0.0, 0.2]), 1e8 * np.eye(3))
    for side in (1.0, -1.0):
        extrapolator = PoseExtrapolator()
        scan = ScanTracked(0.0, np.zeros(3), np.zeros(3), 0.9, 0, np.zeros((0, 2)), 1e-6 * np.eye(3), model)
        extrapolator.at(reading(0.0, 0.0, 0.0, 0.0))
        extrapolator.handle(scan)
        for turned in side * np.linspace(0.0, 3.0 * np.pi, 100):
            pose = extrapolator.at(reading(1.0 + abs(turned), 0.0, 0.0, float(se2.wrap(1.25 * turned))))
            assert pose is not None
            assert abs(se2.wrap(pose.pose[2] - turned)) < 0.05
            assert np.hypot(*pose.pose[:2]) < 0.01


def test_the_covariance_is_that_of_the_scan_and_grows_with_the_motion_since() -> None:
    extrapolator = PoseExtrapolator()
    assert extrapolator.at(reading(0.0, 0.0, 0.0, 0.0)) is None
    model = Slam().slam_state.odometry_model
    own = np.diag([1e-4, 4e-4, 1e-5])
    scan = ScanTracked(1.0, np.array([3.0, 2.0, 0.7]), np.array([1.0, 0.0, 0.2]), 0.9, 0, np.zeros((0, 2)), own, model)
    extrapolator.handle(scan)
    standing = extrapolator.at(reading(1.1, 1.0, 0.0, 0.2))
    assert standing is not None
    np.testing.assert_allclose(standing.pose, scan.pose)
    np.testing.assert_allclose(standing.covariance, own, atol=1e-15)
    np.testing.assert_allclose(se2.compose(standing.odometry_in_map, standing.odometry), standing.pose, atol=1e-12)
    driven = [extrapolator.at(Odometry(1.0 + k, se2.compose(scan.odometry, [0.1 * k, 0.0, 0.0]))) for k in (1, 2, 3)]
    sizes = [np.linalg.det(pose.covariance) for pose in driven if pose is not None]
    assert np.linalg.det(own) < sizes[0] < sizes[1] < sizes[2]
    assert driven[2] is not None
    np.testing.assert_allclose(driven[2].pose, se2.compose(scan.pose, [0.3, 0.0, 0.0]), atol=1e-9)


def test_while_odometry_fails_the_robot_moves_on_as_the_scans_have_measured_it() -> None:
    extrapolator = PoseExtrapolator()
    model, own = Slam().slam_state.odometry_model, np.diag([1e-4, 4e-4, 1e-5])
    velocity = VelocityFilter(np.array([0.5, 0.0, 0.0]), np.array([1e-4, 1e-4, 1e-4]))
    pose = np.array([3.0, 2.0, np.pi / 2])
    extrapolator.handle(ScanTracked(1.0, pose, np.zeros(3), 0.9, 0, np.zeros((0, 2)), own, model, velocity))
    poses = [extrapolator.at(reading(1.0 + seconds, 0.0, 0.0, 0.0)) for seconds in (0.1, 0.2, 30.0)]  # wheels stand
    assert all(poses)
    moved = [2.05, 2.1, 2.0 + 0.5 * STEADY_SECONDS]
    np.testing.assert_allclose([now.pose[1] for now in poses if now], moved, atol=1e-12)
    sizes = [np.linalg.det(now.covariance) for now in poses if now]
    assert np.linalg.det(own) < sizes[0] < sizes[1] < sizes[2]


def test_a_base_that_is_switched_off_keeps_its_extrapolated_pose_on_the_path() -> None:
    """Robot is pushed on at up to 0.5 m/s; odometry stands still from the middle of the drive on."""
    extrapolator, frozen_at = PoseExtrapolator(), 6.0
    slam, truth, errors = Slam(sinks=[extrapolator]), {}, []
    frozen: Odometry | None = None
    for message in as_they_arrive(messages()):
        if isinstance(message, GroundTruth):
            truth[message.stamp] = message.pose
        if isinstance(message, Odometry):
            frozen = message if message.stamp <= frozen_at or frozen is None else Odometry(message.stamp, frozen.pose)
            message = frozen
            now = extrapolator.at(message)
            if now is not None and message.stamp in truth and message.stamp > frozen_at + 2.0 * STEADY_SECONDS:
                errors.append(se2.between(se2.between(truth[min(truth)], truth[message.stamp]), now.pose))
        slam.add(message)
    assert len(errors) > 100
    assert np.median(np.hypot(*np.array(errors)[:, :2].T)) < 0.02
    assert np.hypot(*np.array(errors)[:, :2].T).max() < 0.1


def test_a_changed_map_and_a_lost_robot_are_noticed_at_once() -> None:
    extrapolator = PoseExtrapolator()
    pose, odometry = np.array([3.0, 2.0, 0.7]), np.array([1.0, 0.0, 0.2])
    extrapolator.handle(ScanTracked(1.0, pose, odometry, 0.9, 0))
    extrapolator.handle(StateChanged(1.0, "LOST", None))
    moved = pose + np.array([0.5, 0.0, 0.0])
    keyframe: KeyframeAdded = object.__new__(KeyframeAdded)
    for name, value in {"pose": moved, "pose_covariance": np.eye(3), "odometry": odometry}.items():
        object.__setattr__(keyframe, name, value)
    extrapolator.handle(keyframe)
    now = extrapolator.at(Odometry(1.1, odometry))
    assert now is not None
    np.testing.assert_allclose(now.pose, moved)
    assert now.status is LocalisationStatus.LOST


def test_odometry_is_compared_as_it_was_measured() -> None:
    """Not as a gyroscope has improved it, in a frame that drifts away; and at the time of the scan on its own clock."""
    extrapolator = PoseExtrapolator(delay=0.1)
    for k in range(11):
        extrapolator.at(reading(1.0 + 0.02 * k, 0.01 * k, 0.0, 0.0))
    pose = np.array([3.0, 2.0, np.pi / 2])
    extrapolator.handle(ScanTracked(1.21, pose, np.array([9.0, 9.0, 1.0]), 0.9, 0))  # measured at 1.11
    now = extrapolator.at(reading(1.22, 0.11, 0.0, 0.0))
    assert now is not None
    np.testing.assert_allclose(now.pose, [3.0, 2.0 + 0.055, np.pi / 2], atol=1e-12)


def test_stamps_on_another_clock_are_not_compared() -> None:
    extrapolator = PoseExtrapolator()
    extrapolator.at(reading(1.0, 5.0, 0.0, 0.0))
    extrapolator.handle(ScanTracked(3601.0, np.zeros(3), np.array([4.9, 0.0, 0.0]), 0.9, 0))
    now = extrapolator.at(reading(1.02, 5.02, 0.0, 0.0))
    assert now is not None
    np.testing.assert_allclose(now.pose, [0.12, 0.0, 0.0], atol=1e-12)

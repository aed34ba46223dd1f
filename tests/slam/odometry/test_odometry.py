"""Odometry between its readings, how far it is trusted, sweeps straightened with it, and the path that it bridges."""

from itertools import pairwise

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.simulation import LidarModel, Simulation, WheelModel, World
from features import Extractor, Noise
from slam.config import OdometryConfig
from slam.geometry.segments import corner_points, segments_from_lines
from slam.mapping.trajectory_builder import TrajectoryBuilder
from slam.odometry.error_model import OdometryModel, fuse_motion
from slam.odometry.history import OdometryHistory, wheel_travel
from slam.preprocessing.deskew import add_motion_uncertainty, deskew, sweep_middle

CIRCLE = 0.8, 1.2  # metres a second, radians a second
HELD = np.diag([1e6, 1e6, 1e6])  # by what is seen, in all directions
CORRIDOR = np.diag([0.0, 1e6, 1e6])  # and across a corridor only


def history(count: int = 20, interval: float = 0.1) -> OdometryHistory:
    """A robot that drives in a circle."""
    told = OdometryHistory()
    for k in range(count):
        told.add(Odometry(interval * k, on_circle(interval * k)))
    return told


def on_circle(time: float) -> np.ndarray:
    speed, rate = CIRCLE
    turn = rate * time
    return np.array([speed / rate * np.sin(turn), speed / rate * (1 - np.cos(turn)), se2.wrap(turn)])


def test_between_readings_the_robot_drives_on() -> None:
    told = history()
    for stamp in (0.0, 0.05, 0.3, 0.512, 1.9):
        np.testing.assert_allclose(told.at(stamp), on_circle(stamp), atol=2e-3)
    np.testing.assert_array_equal(told.at(-1.0), told.poses[0])
    np.testing.assert_array_equal(told.at(99.0), told.poses[-1])
    assert told.at_each(np.array([0.1, 0.2])).shape == (2, 3)
    assert told.at_each(np.zeros(0)).shape == (0, 3)


def test_headings_are_interpolated_the_shorter_way_round() -> None:
    told = OdometryHistory()
    told.add(Odometry(0.0, np.array([0.0, 0.0, 3.1])))
    told.add(Odometry(1.0, np.array([0.0, 0.0, -3.1])))
    assert abs(told.at(0.5)[2]) == pytest.approx(np.pi)


def test_a_stamp_told_twice_or_too_late_replaces_the_last() -> None:
    told = OdometryHistory()
    assert told.latest == -np.inf
    for stamp, x in ((0.0, 0.0), (1.0, 1.0), (1.0, 2.0), (0.5, 3.0)):
        told.add(Odometry(stamp, np.array([x, 0.0, 0.0])))
    np.testing.assert_array_equal(told.stamps, [0.0, 1.0])
    np.testing.assert_array_equal(told.poses[:, 0], [0.0, 3.0])


@pytest.mark.parametrize(("translation", "rotation"), [(0.05, 0.03), (0.2, 0.1)])
def test_rates_are_learned_in_spite_of_gross_errors(translation: float, rotation: float) -> None:
    random, noise = np.random.default_rng(0), OdometryModel(OdometryConfig())
    for k in range(400):
        claimed = np.array([random.uniform(0.1, 0.5), 0.0, random.uniform(-0.2, 0.2)])
        way = wheel_travel(claimed)
        error = random.normal(size=3) * [translation * way, translation * way, rotation * np.sqrt(way)]
        if k % 10 == 0:
            error += [0.5, 0.0, 0.5]
        noise.add_motion(claimed, se2.compose(claimed, error), HELD)
    assert noise.deviations == pytest.approx([translation, rotation], rel=0.4)


def test_nothing_is_learned_where_that_is_configured_or_the_robot_stands() -> None:
    claimed, found = np.array([1.0, 0.0, 0.0]), np.array([1.5, 0.0, 0.5])
    fixed = OdometryModel(OdometryConfig(learn=False))
    before = fixed.deviations.copy()
    fixed.add_motion(claimed, found, HELD)
    np.testing.assert_array_equal(fixed.deviations, before)
    noise = OdometryModel(OdometryConfig())
    noise.add_motion(0.01 * claimed, found, HELD)
    np.testing.assert_array_equal(noise.deviations, before)
    assert np.linalg.eigvalsh(noise.covariance(np.zeros(3))).min() > 0


def test_a_corridor_does_not_teach_that_odometry_is_right_along_it() -> None:
    random, noise = np.random.default_rng(0), OdometryModel(OdometryConfig(translation_error=0.1))
    claimed = np.array([0.3, 0.0, 0.0])
    for _ in range(200):
        noise.add_motion(claimed, se2.compose(claimed, [0.0, random.normal(0, 1e-3), random.normal(0, 0.01)]), CORRIDOR)
    assert noise.deviations == pytest.approx(OdometryModel(OdometryConfig(translation_error=0.1)).deviations)


def test_what_is_common_to_all_motions_is_taken_out_of_them() -> None:
    random, noise = np.random.default_rng(0), OdometryModel(OdometryConfig())
    length, turning, veer = 0.96, 1.1, 0.05
    for k in range(400):
        claimed = np.array([random.uniform(0.2, 0.4), 0.0, random.choice([0.0, random.uniform(-0.4, 0.4)])])
        turn = turning * claimed[2] + veer * claimed[0]
        bend = 0.5 * (turn - claimed[2])
        found = np.array([length * claimed[0] * np.cos(bend), length * claimed[0] * np.sin(bend), turn])
        gross = [0.5, 0.0, 0.5] if k % 10 == 0 else [0.0, 0.0, 0.0]
        noise.add_motion(claimed, se2.compose(found, random.normal(0, [3e-3, 3e-3, 5e-3]) + gross), HELD)
    assert noise.systematic_errors == pytest.approx([length, turning, veer], abs=0.01)
    np.testing.assert_allclose(noise.correct(claimed), found, atol=0.01)
    assert noise.deviations[0] < 0.02  # what was taken out is not noise any more
    again = OdometryModel(OdometryConfig())
    again.add_samples(noise.samples)
    np.testing.assert_array_equal(again.systematic_errors, noise.systematic_errors)


def test_errors_add_up_where_nothing_holds_the_robot() -> None:
    model, step = OdometryModel(OdometryConfig(translation_error=0.1)), np.array([0.3, 0.0, 0.0])
    assert not model.correlated_drift(step, HELD).any()
    correlated_drift = model.correlated_drift(step, CORRIDOR)
    np.testing.assert_allclose(
        correlated_drift[1:], 0.0, atol=1e-3 * correlated_drift[0, 0]
    )  # across, the walls hold it
    steps = 50  # 15 metres; a wheel that is a tenth too large errs by 1.5
    assert np.sqrt(steps * correlated_drift[0, 0]) > 1.5 > 5 * np.sqrt(steps * model.covariance(step)[0, 0])


def test_points_correct_the_motion_only_where_they_say_something() -> None:
    claimed, found = np.array([0.3, 0.0, 0.0]), np.array([0.26, 0.02, 0.01])
    covariance = np.diag([0.02, 0.02, 0.01]) ** 2
    same, unchanged = fuse_motion(claimed, covariance, found, np.zeros((3, 3)))
    np.testing.assert_allclose(same, claimed)
    np.testing.assert_allclose(unchanged, covariance)
    motion, fused = fuse_motion(claimed, covariance, found, np.diag([1e8, 0.0, 0.0]))
    np.testing.assert_allclose(motion, [0.26, 0.0, 0.0], atol=1e-4)
    assert fused[0, 0] < 1e-7
    assert fused[1, 1] == pytest.approx(covariance[1, 1])


def spinning() -> Simulation:
    """A perfect lidar and perfect odometry in a square room, going around a corner at 1 rad/s."""
    corners = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    walls = np.hstack([corners, np.roll(corners, -1, axis=0)])
    path = np.array([[-1.0, 0.0], [0.5, 0.0], [0.5, 1.0], [-1.0, 1.0], [-1.0, 0.0]])
    world = World("square", "square", walls, np.zeros((0, 3)), path, 0.5)
    wheels = WheelModel(slip=0.0, encoder=0.0, scale_bias=0.0, difference_bias=0.0, wheelbase_bias=0.0)
    lidar = LidarModel(sigma_range=0.0, sigma_bearing=0.0, dropouts=0.02, mixed=0.0)
    return Simulation(world, duration=8.0, lidar=lidar, wheels=wheels)


def test_walls_stay_straight_and_where_they_are_while_the_robot_turns() -> None:
    simulation = spinning()
    messages = list(simulation)
    told = OdometryHistory()
    for message in messages:
        if isinstance(message, Odometry):
            told.add(message)
    scans = [message for message in messages if isinstance(message, Scan)]
    poses = simulation.trajectory.poses_at(np.array([scan.stamp for scan in scans]))
    turning = [k for k, (a, b) in enumerate(pairwise(poses)) if abs(se2.wrap(b[2] - a[2])) > 0.08][:12]
    assert len(turning) > 5
    skewed = []
    for k in turning:
        sweep = deskew(scans[k], told, simulation.mount)
        lidar = se2.compose(simulation.trajectory.poses_at(np.array([sweep.stamp]))[0], simulation.mount)
        local = np.column_stack([sweep.ranges * np.cos(sweep.bearings), sweep.ranges * np.sin(sweep.bearings)])
        points = se2.transform(lidar, local[np.isfinite(sweep.ranges)])
        assert np.abs(np.abs(points).max(axis=1) - 3.0).max() < 0.003
        assert (np.isnan(sweep.ranges) == np.isnan(scans[k].ranges)).all()
        assert (np.diff(sweep.bearings) > 0).all()
        raw = scans[k].ranges[:, None] * np.column_stack([np.cos(scans[k].angles), np.sin(scans[k].angles)])
        skewed.append(np.nanmax(np.abs(np.abs(se2.transform(lidar, raw)).max(axis=1) - 3.0)))
    assert min(skewed) > 0.05  # as it would be otherwise


def test_a_sweep_at_once_is_left_as_it_is() -> None:
    scan = Scan(1.0, np.array([1.0, np.nan, 2.0]), np.array([0.0, 0.1, 0.2]), np.zeros(3), 0.1, 10.0)
    sweep = deskew(scan, history(), np.zeros(3))
    np.testing.assert_array_equal(sweep.ranges, scan.ranges)
    np.testing.assert_array_equal(sweep.bearings, scan.angles)
    assert sweep.stamp == sweep_middle(scan) == 1.0
    assert not sweep.travel.any()
    empty = Scan(1.0, np.zeros(0), np.zeros(0), np.zeros(0), 0.1, 10.0)
    assert len(deskew(empty, history(), np.zeros(3)).ranges) == 0


def test_the_jitter_of_a_reading_does_not_turn_the_scan() -> None:
    random, told, stamps = np.random.default_rng(2), OdometryHistory(), np.arange(0.0, 40.0, 0.04)
    for stamp in stamps:
        told.add(Odometry(stamp, on_circle(stamp) + np.array([0.0, 0.0, random.normal(0.0, 5e-4)])))
    errors = []
    for stamp in np.arange(1.0, 39.0, 0.1):
        scan = Scan(stamp, np.full(9, 2.0), np.linspace(-1, 1, 9), np.linspace(0.0, 0.1, 9), 0.1, 10.0)
        sweep = deskew(scan, told, np.zeros(3))
        true = on_circle(sweep.stamp)
        errors.append([se2.wrap(pose[2] - true[2]) for pose in (sweep.odometry, told.at(sweep.stamp))])
    smoothed, read = np.sqrt(np.mean(np.square(errors), axis=0))
    assert smoothed < 0.8 * read


def test_a_change_of_speed_is_no_jitter() -> None:
    told = OdometryHistory()
    for stamp in np.arange(0.0, 2.0, 0.01):  # stands, then turns at a stroke
        told.add(Odometry(stamp, np.array([0.0, 0.0, 2.0 * max(0.0, stamp - 1.0)])))
    scan = Scan(0.95, np.full(9, 2.0), np.linspace(-1, 1, 9), np.linspace(0.0, 0.1, 9), 0.1, 10.0)
    assert abs(deskew(scan, told, np.zeros(3)).odometry[2]) < 1e-3  # not the 25 milliradians that it is on the mean


def test_a_longer_sweep_makes_lines_less_certain() -> None:
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    ranges = 2.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    noise, variances = OdometryModel(OdometryConfig()), []
    for duration in (0.0, 0.1, 0.4):
        scan = Scan(0.5, ranges, angles, np.linspace(0.0, duration, 360), 0.1, 10.0)
        sweep = deskew(scan, history(), np.zeros(3))
        features = Extractor(Noise(0.01, 0.001)).extract(ranges, angles)
        segments = segments_from_lines(features.lines, np.zeros(3))
        corners = corner_points(features.corners, segments, np.zeros(3))
        segments, corners = add_motion_uncertainty(segments, corners, features.lines, sweep, noise)
        assert np.linalg.eigvalsh(segments.covariance).min() > 0
        variances.append([segments.covariance[:, 0, 0].sum(), np.trace(corners.covariance, axis1=1, axis2=2).sum()])
    assert (np.diff(variances, axis=0) > 0).all()


def test_the_path_goes_through_the_scans_and_does_not_jump() -> None:
    told, random = history(100, 0.04), np.random.default_rng(1)
    path, keyframes = TrajectoryBuilder(), []
    stamps = np.arange(0.11, 3.5, 0.25)
    for k, stamp in enumerate(stamps):  # the map is turned against the odometry, which drifts
        true = se2.compose([5.0, -2.0, 2.5], on_circle(stamp) + np.array([0.02 * stamp, 0.0, 0.01 * stamp]))
        keyframes.append(se2.compose(true, random.normal(0, 0.1, 3)))
        path.add(float(stamp), k, se2.between(keyframes[k], true), np.eye(3))
    at, poses = path.at_odometry(np.array(keyframes), told)
    np.testing.assert_array_equal(at, told.stamps)
    scan_stamps, scan_poses = path.at_scans(np.array(keyframes))
    headings = np.unwrap(poses[:, 2])
    for stamp, pose in zip(scan_stamps, scan_poses, strict=True):
        on_path = [np.interp(stamp, at, poses[:, 0]), np.interp(stamp, at, poses[:, 1]), np.interp(stamp, at, headings)]
        np.testing.assert_allclose(on_path[:2], pose[:2], atol=2e-3)
        assert abs(se2.wrap(on_path[2] - pose[2])) < 2e-3
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() < 1.5 * CIRCLE[0] * 0.04
    assert np.abs(np.diff(headings)).max() < 1.5 * CIRCLE[1] * 0.04


def test_what_odometry_misses_is_missed_while_the_wheels_roll() -> None:
    told, path = OdometryHistory(), TrajectoryBuilder()
    for k in range(21):  # stands for a second, then drives for one at half a metre a second
        told.add(Odometry(0.1 * k, np.array([max(0.0, 0.05 * (k - 10)), 0.0, 0.0])))
    path.add(0.0, 0, np.zeros(3), np.eye(3))
    path.add(2.0, 0, np.array([0.6, 0.0, 0.2]), np.eye(3))
    _, poses = path.at_odometry(np.zeros((1, 3)), told)
    np.testing.assert_allclose(poses[:11], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(poses[10:], axis=0), np.tile([0.06, 0.0, 0.02], (10, 1)), atol=1e-12)


def test_one_scan_is_path_enough() -> None:
    told, path = history(), TrajectoryBuilder()
    path.add(0.55, 0, np.array([1.0, 0.0, 0.0]), np.eye(3))
    _, poses = path.at_odometry(np.array([[1.0, 1.0, np.pi / 2]]), told)
    there = se2.compose([1.0, 2.0, np.pi / 2], se2.between(told.at(0.55), told.at(0.0)))
    np.testing.assert_allclose(poses[0], there, atol=1e-9)
    assert len(poses) == 20

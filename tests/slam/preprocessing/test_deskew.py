"""De-skewing: the beams of a sweep are corrected for the robot's motion, and the uncertainty of it is propagated."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.simulation import LidarModel, Simulation, WheelModel, World
from features import Extractor, Noise
from slam.config import LidarConfig, OdometryConfig
from slam.errors import MapError
from slam.geometry.line_segments import corner_points, segments_from_lines
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import OdometryHistory, wheel_travel
from slam.preprocessing.deskew import deskew, lidar_mount, sweep_middle
from slam.preprocessing.motion_uncertainty import add_motion_uncertainty

from ..odometry.circle import circle_history, pose_on_circle


def spinning(rate: float = 10.0, wheelbase: float = 0.35) -> Simulation:
    """Return a drive with a perfect lidar and perfect wheels in a square room, turning at 1 rad/s at a corner."""
    corners = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    walls = np.hstack([corners, np.roll(corners, -1, axis=0)])
    path = np.array([[-1.0, 0.0], [0.5, 0.0], [0.5, 1.0], [-1.0, 1.0], [-1.0, 0.0]])
    world = World("square", "square", walls, np.zeros((0, 3)), path, 0.5)
    wheels = WheelModel(slip=0.0, encoder=0.0, scale_bias=0.0, difference_bias=0.0, wheelbase_bias=0.0)
    lidar = LidarModel(rate=rate, sigma_range=0.0, sigma_bearing=0.0, dropouts=0.02, mixed=0.0)
    return Simulation(world, duration=8.0, lidar=lidar, wheels=wheels)


def history_of(simulation: Simulation, turn_factor: float = 1.0) -> OdometryHistory:
    """Return the odometry of a drive, whose turns are measured too large by a factor."""
    history, pose, before = OdometryHistory(), np.zeros(3), np.zeros(3)
    for message in simulation:
        if isinstance(message, Odometry):
            pose = se2.compose(pose, se2.between(before, message.pose) * [1.0, 1.0, turn_factor])
            before = message.pose
            history.add(Odometry(message.stamp, pose))
    return history


def largest_error(simulation: Simulation, history: OdometryHistory, model: OdometryModel | None = None) -> float:
    """Return the largest distance of a de-skewed point from the walls, metres."""
    worst = 0.0
    for scan in (message for message in simulation if isinstance(message, Scan)):
        sweep = deskew(scan, history, simulation.mount, 0.0, model)
        lidar = se2.compose(simulation.trajectory.poses_at(np.array([sweep.stamp]))[0], simulation.mount)
        local = np.column_stack([sweep.ranges * np.cos(sweep.bearings), sweep.ranges * np.sin(sweep.bearings)])
        points = se2.transform(lidar, local[np.isfinite(sweep.ranges)])
        worst = max(worst, float(np.abs(np.abs(points).max(axis=1) - 3.0).max()))
    return worst


def test_slow_sweeps_follow_changes_of_speed() -> None:
    """The robot begins and ends its turns within sweeps of half a second."""
    simulation = spinning(rate=2.0)
    assert largest_error(simulation, history_of(simulation)) < 0.02


def test_systematic_errors_of_odometry_are_corrected() -> None:
    simulation, factor = spinning(), 1.1
    history, model = history_of(simulation, factor), OdometryModel(OdometryConfig())
    turns = np.column_stack([np.full(200, 0.1), np.zeros(200), np.full(200, 0.2)])
    model.add_samples(np.hstack([turns * [1.0, 1.0, factor], turns, np.zeros((200, 2))]))
    assert largest_error(simulation, history, model) < 0.35 * largest_error(simulation, history)


def test_information_of_points_is_limited_by_the_motion_during_the_sweep() -> None:
    """The mean of a random walk from the middle of a sweep to its ends has the variance that the information admits."""
    random, model, travel, steps = np.random.default_rng(4), OdometryModel(OdometryConfig()), 0.05, 100
    rotation = float(model.variances(np.array(travel))[1])
    halves = random.normal(0.0, np.sqrt(rotation / steps), (4000, 2, steps)).cumsum(axis=2).mean(axis=2)
    expected = np.var(0.5 * (halves[:, 0] + halves[:, 1]))
    limited = model.limit_information(np.diag([0.0, 1e12, 1e12]), travel)
    assert 1.0 / limited[2, 2] == pytest.approx(expected, rel=0.1)
    assert limited[0, 0] == 0.0
    np.testing.assert_array_equal(model.limit_information(np.eye(3), 0.0), np.eye(3))


def test_walls_stay_straight_and_in_place_while_the_robot_turns() -> None:
    simulation = spinning()
    messages = list(simulation)
    history = OdometryHistory()
    for message in messages:
        if isinstance(message, Odometry):
            history.add(message)
    scans = [message for message in messages if isinstance(message, Scan)]
    poses = simulation.trajectory.poses_at(np.array([scan.stamp for scan in scans]))
    turning = [k for k, (a, b) in enumerate(pairwise(poses)) if abs(se2.wrap(b[2] - a[2])) > 0.08][:12]
    assert len(turning) > 5
    skewed = []
    for k in turning:
        sweep = deskew(scans[k], history, simulation.mount)
        lidar = se2.compose(simulation.trajectory.poses_at(np.array([sweep.stamp]))[0], simulation.mount)
        local = np.column_stack([sweep.ranges * np.cos(sweep.bearings), sweep.ranges * np.sin(sweep.bearings)])
        points = se2.transform(lidar, local[np.isfinite(sweep.ranges)])
        assert np.abs(np.abs(points).max(axis=1) - 3.0).max() < 0.003
        assert (np.isnan(sweep.ranges) == np.isnan(scans[k].ranges)).all()
        assert (np.diff(sweep.bearings) > 0).all()
        raw = scans[k].ranges[:, None] * np.column_stack([np.cos(scans[k].angles), np.sin(scans[k].angles)])
        skewed.append(np.nanmax(np.abs(np.abs(se2.transform(lidar, raw)).max(axis=1) - 3.0)))
    assert min(skewed) > 0.05  # without de-skewing


def test_the_poses_at_the_beams_are_those_of_the_drive() -> None:
    """Within a millimetre and a milliradian, also between the poses from which they are interpolated."""
    simulation = spinning()
    history = history_of(simulation)
    for scan in (message for message in simulation if isinstance(message, Scan)):
        motion = deskew(scan, history, simulation.mount).motion
        true = simulation.trajectory.poses_at(sweep_middle(scan) + motion.times)
        middle = simulation.trajectory.poses_at(np.array([sweep_middle(scan)]))
        np.testing.assert_allclose(motion.poses, se2.between(middle, true), atol=1e-3)


@pytest.mark.parametrize(("interval", "expected"), [(0.001, 0.001), (0.02, 0.02), (0.07, 0.07), (0.5, 0.1)])
def test_the_error_of_odometry_changes_evenly_between_readings(interval: float, expected: float) -> None:
    """Where they are far apart, it changes evenly while robots move smoothly."""
    odometry = circle_history(round(2.0 / interval), interval)
    scan = Scan(1.03, np.ones(40), np.linspace(0.0, 6.0, 40), np.linspace(0.0, 0.1, 40), 0.1, 10.0)
    motion, middle = deskew(scan, odometry, np.zeros(3)).motion, sweep_middle(scan)
    assert motion.breakpoints[0] <= motion.times[0] < motion.times[-1] <= motion.breakpoints[-1]
    assert np.diff(motion.breakpoints).max() < expected + 1e-9
    if interval == expected:
        assert np.abs(motion.breakpoints[:, None] + middle - odometry.stamps).min(axis=1).max() < 1e-9
    poses = odometry.at_each(motion.breakpoints + middle)
    np.testing.assert_allclose(motion.steps, wheel_travel(se2.between(poses[:-1], poses[1:])), rtol=2e-3)


def test_noise_of_dense_readings_does_not_count_as_travel() -> None:
    exact, random = circle_history(2000, 0.001), np.random.default_rng(0)
    noisy = OdometryHistory.from_arrays(exact.stamps, exact.poses + 2e-4 * random.standard_normal((2000, 3)))
    scan = Scan(1.03, np.ones(40), np.linspace(0.0, 6.0, 40), np.linspace(0.0, 0.1, 40), 0.1, 10.0)
    travelled = [deskew(scan, odometry, np.zeros(3)).motion.steps.sum() for odometry in (exact, noisy)]
    assert travelled[1] == pytest.approx(travelled[0], rel=0.05)


def test_an_instantaneous_sweep_is_unchanged() -> None:
    scan = Scan(1.0, np.array([1.0, np.nan, 2.0]), np.array([0.0, 0.1, 0.2]), np.zeros(3), 0.1, 10.0)
    sweep = deskew(scan, circle_history(), np.zeros(3))
    np.testing.assert_array_equal(sweep.ranges, scan.ranges)
    np.testing.assert_array_equal(sweep.bearings, scan.angles)
    assert sweep.stamp == sweep_middle(scan) == 1.0
    assert sweep.motion.reach == 0.0
    empty = Scan(1.0, np.zeros(0), np.zeros(0), np.zeros(0), 0.1, 10.0)
    assert len(deskew(empty, circle_history(), np.zeros(3)).ranges) == 0


@pytest.mark.parametrize("jitter", [0.0, 2e-4, 5e-4])
def test_the_scan_of_a_standing_robot_is_not_bent_by_jitter(jitter: float) -> None:
    """Readings err independently: by `jitter` metres, and by as much of turning, at wheels 0.35 m apart."""
    random, stamps = np.random.default_rng(5), np.arange(0.0, 40.0, 0.04)
    poses = jitter * np.array([1.0, 0.0, 1.0 / 0.175]) * random.standard_normal((len(stamps), 3))
    standing, slow = (
        OdometryHistory.from_arrays(stamps, poses + np.outer(speed * stamps, [1.0, 0.0, 0.0])) for speed in (0.0, 0.09)
    )
    angles, offsets = np.linspace(-3.0, 3.0, 61), np.linspace(0.0, 0.18, 61)
    scans = [Scan(stamp, np.full(61, 2.0), angles, offsets, 0.1, 10.0) for stamp in np.arange(0.01, 39.0, 0.2)]
    bent = [bool(deskew(scan, standing, np.zeros(3)).motion.reach) for scan in scans]
    assert np.mean(bent) < 0.02
    moved = [bool(deskew(scan, slow, np.zeros(3)).motion.reach) for scan in scans]
    assert np.mean(moved) > 0.98


def test_the_jitter_of_a_reading_does_not_rotate_the_scan() -> None:
    random, history, stamps = np.random.default_rng(2), OdometryHistory(), np.arange(0.0, 40.0, 0.01)
    for stamp in stamps:
        history.add(Odometry(stamp, pose_on_circle(stamp) + np.array([0.0, 0.0, random.normal(0.0, 5e-4)])))
    errors = []
    for stamp in np.arange(1.0, 39.0, 0.1):
        scan = Scan(stamp, np.full(9, 2.0), np.linspace(-1, 1, 9), np.linspace(0.0, 0.1, 9), 0.1, 10.0)
        sweep = deskew(scan, history, np.zeros(3))
        true = pose_on_circle(sweep.stamp)
        errors.append([se2.wrap(pose[2] - true[2]) for pose in (sweep.odometry, history.at(sweep.stamp))])
    smoothed, read = np.sqrt(np.mean(np.square(errors), axis=0))
    assert smoothed < 0.6 * read


def test_random_errors_of_odometry_do_not_rotate_the_scan() -> None:
    """The beams are turned by their own errors, and not all by that of the reading in the middle."""
    random, history = np.random.default_rng(3), OdometryHistory()
    model, stamps = OdometryModel(OdometryConfig(rotation_walk=0.05)), np.arange(0.0, 40.0, 0.01)
    rotation = float(model.variances(np.array(0.005))[1])  # between two readings at 0.5 m/s
    headings = np.cumsum(np.sqrt(rotation) * random.standard_normal(len(stamps)))
    for stamp, heading in zip(stamps, headings, strict=True):
        history.add(Odometry(stamp, np.array([0.5 * stamp, 0.0, heading])))
    angles, offsets, turned = np.linspace(-1, 1, 41), np.linspace(0.0, 0.1, 41), []
    for stamp in np.arange(1.0, 39.0, 0.1):
        scan = Scan(stamp, np.full(41, 1e6), angles, offsets, 0.1, 1e7)  # too far for the position to matter
        sweeps = [deskew(scan, history, np.zeros(3), model=used) for used in (None, model)]
        turned.append([np.mean(sweep.bearings - angles) for sweep in sweeps])
    by_reading, by_fit = np.sqrt(np.mean(np.square(turned), axis=0))
    assert by_fit < 0.75 * by_reading


@pytest.mark.parametrize("acceleration", [-3.0, 3.0])
def test_a_constant_acceleration_does_not_move_the_reference(acceleration: float) -> None:
    history = OdometryHistory()
    for stamp in np.arange(0.0, 2.0, 0.01):
        history.add(Odometry(stamp, np.array([0.0, 0.0, 0.5 * acceleration * stamp**2])))
    scan = Scan(1.0, np.full(9, 2.0), np.linspace(-1, 1, 9), np.linspace(0.0, 0.1, 9), 0.1, 10.0)
    sweep = deskew(scan, history, np.zeros(3), model=OdometryModel(OdometryConfig(rotation_walk=0.05)))
    heading = 0.5 * acceleration * sweep.stamp**2
    assert sweep.odometry[2] == pytest.approx(se2.wrap(heading), abs=1e-4)  # odometry's mean is 1.25 mrad off


def test_a_change_of_speed_is_not_smoothed_as_jitter() -> None:
    history = OdometryHistory()
    for stamp in np.arange(0.0, 2.0, 0.01):  # stands, then turns suddenly
        history.add(Odometry(stamp, np.array([0.0, 0.0, 2.0 * max(0.0, stamp - 1.0)])))
    scan = Scan(0.95, np.full(9, 2.0), np.linspace(-1, 1, 9), np.linspace(0.0, 0.1, 9), 0.1, 10.0)
    assert abs(deskew(scan, history, np.zeros(3)).odometry[2]) < 1e-3  # the mean over the sweep would be 25 mrad


def test_a_longer_sweep_increases_the_covariances() -> None:
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    ranges = 2.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    noise, variances = OdometryModel(OdometryConfig()), []
    for duration in (0.0, 0.1, 0.4):
        scan = Scan(0.5, ranges, angles, np.linspace(0.0, duration, 360), 0.1, 10.0)
        sweep = deskew(scan, circle_history(), np.zeros(3))
        features = Extractor(Noise(0.01, 0.001)).extract(ranges, angles)
        segments = segments_from_lines(features.lines, np.zeros(3))
        corners = corner_points(features.corners, segments, np.zeros(3))
        segments, corners, of_sweep = add_motion_uncertainty(
            segments, corners, features.lines, sweep, noise, Noise(0.01, 0.001), np.zeros(3)
        )
        assert np.linalg.eigvalsh(segments.covariance).min() > 0
        of_corners = np.trace(corners.covariance, axis1=1, axis2=2).sum()
        variances.append([segments.covariance[:, 0, 0].sum(), of_corners, *np.diag(of_sweep)])
    assert (np.diff(variances, axis=0) > 0).all()


def test_a_recorded_mount_that_no_robot_has_is_refused() -> None:
    scan = Scan(0.0, np.ones(3), np.zeros(3), np.zeros(3), 0.1, 10.0)
    assert lidar_mount(scan, LidarConfig()).tolist() == [0.0, 0.0, 0.0]
    assert lidar_mount(replace(scan, mount=np.array([-1.5, 0.0, 3.0])), LidarConfig()).tolist() == [-1.5, 0.0, 3.0]
    for x in (250.0, math.nan):  # in millimetres, for example
        wrong = replace(scan, mount=np.array([x, 0.0, 0.0]))
        with pytest.raises(MapError, match=rf"mounted at x {x:g} m, y 0 m, .* as these scans state; lidar\.mount="):
            lidar_mount(wrong, LidarConfig())
        assert lidar_mount(wrong, LidarConfig(mount=(0.1, 0.0, 0.0))).tolist() == [0.1, 0.0, 0.0]
    with pytest.raises(MapError, match="no lidar is mounted at x 0 m, y 0 m, heading 90 radians"):
        lidar_mount(replace(scan, mount=np.array([0.0, 0.0, 90.0])), LidarConfig())

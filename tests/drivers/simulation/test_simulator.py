"""The simulator is repeatable, its noise has the stated statistics, and its worlds can be driven through."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers import GroundTruth, Message, Odometry, RecordingError, Scan, se2
from drivers.messages import Floats
from drivers.simulation import (
    LidarModel,
    Simulation,
    TemporaryShapes,
    WheelModel,
    World,
    load_world,
    warm_up,
    world_names,
)
from drivers.simulation.raycast import TIME_STEP

QUIET = LidarModel(sigma_range=0.0, sigma_bearing=0.0, dropouts=0.0, mixed=0.0)
PERFECT = WheelModel(slip=0.0, encoder=0.0, scale_bias=0.0, difference_bias=0.0, wheelbase_bias=0.0)
ROBOT_RADIUS = 0.25


def scans_of(messages: list[Message]) -> list[Scan]:
    return [message for message in messages if isinstance(message, Scan)]


def truth_of(messages: list[Message]) -> dict[float, Floats]:
    return {message.stamp: message.pose for message in messages if isinstance(message, GroundTruth)}


def square(size: float = 10.0) -> World:
    """Return a square room around the origin with a short drive that turns once."""
    h = size / 2
    walls = np.array([[-h, -h, h, -h], [h, -h, h, h], [h, h, -h, h], [-h, h, -h, -h]])
    return World("square", "square", walls, np.zeros((0, 3)), np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), 0.5)


def test_equal_seeds_give_equal_messages(assert_same: Callable[[list[Message], list[Message]], None]) -> None:
    assert_same(list(Simulation("room", seed=3, duration=2)), list(Simulation("room", seed=3, duration=2)))
    one, other = (scans_of(list(Simulation("room", seed=seed, duration=1)))[0] for seed in (3, 4))
    assert not np.array_equal(one.ranges, other.ranges, equal_nan=True)


def test_noise_of_the_lidar_does_not_change_the_odometry() -> None:
    noisy, quiet = Simulation("room", duration=2), Simulation("room", duration=2, lidar=QUIET)
    poses = [[m.pose for m in source if isinstance(m, Odometry)] for source in (noisy, quiet)]
    assert np.array_equal(poses[0], poses[1])


def test_rates_are_as_stated_and_every_stamp_has_a_ground_truth() -> None:
    messages = list(Simulation("room", duration=10.0, wheels=WheelModel(rate=50.0)))
    truth = truth_of(messages)
    assert len(scans_of(messages)) == 99
    assert sum(isinstance(message, Odometry) for message in messages) == 501
    assert all(message.stamp in truth for message in messages)
    assert len(truth) == sum(isinstance(message, GroundTruth) for message in messages)


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.3, -0.2, 2.0)])
def test_deskewed_beams_end_on_the_walls(mount: tuple[float, float, float]) -> None:
    simulation = Simulation(square(), duration=8.0, lidar=QUIET, wheels=PERFECT, mount=mount)
    for scan in scans_of(list(simulation))[::10]:
        poses = simulation.trajectory.poses_at(scan.stamp + scan.time_offsets)
        ends = np.column_stack([scan.ranges * np.cos(scan.angles), scan.ranges * np.sin(scan.angles)])
        placed = se2.transform(se2.compose(poses, scan.mount), ends)
        assert np.abs(placed).max(axis=1) == pytest.approx(5.0, abs=1e-5)


def test_odometry_without_errors_equals_the_ground_truth() -> None:
    messages = list(Simulation(square(), duration=8.0, wheels=PERFECT))
    truth = truth_of(messages)
    start = truth[0.0]
    for message in messages:
        if isinstance(message, Odometry):
            error = se2.between(se2.compose(start, message.pose), truth[message.stamp])
            assert np.abs(error).max() < 1e-3  # odometry approximates a few short arcs by one


def test_range_noise_is_white_and_as_stated() -> None:
    still = replace(square(), speed=1e-6)
    noisy = Simulation(still, seed=5, duration=15.0, lidar=replace(QUIET, sigma_range=0.02))
    exact = Simulation(still, seed=5, duration=15.0, lidar=QUIET)
    noise = np.array([a.ranges - b.ranges for a, b in zip(*map(scans_of, (list(noisy), list(exact))), strict=True)])
    n = noise.size
    assert np.std(noise) == pytest.approx(0.02, rel=4 / np.sqrt(2 * n))
    assert abs(noise.mean()) < 4 * 0.02 / np.sqrt(n)
    assert np.mean((noise / 0.02) ** 4) == pytest.approx(3.0, abs=4 * np.sqrt(96 / n))  # kurtosis of a Gaussian
    for a, b in ((noise[:, :-1], noise[:, 1:]), (noise[:-1], noise[1:])):  # between beams, between scans
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(n)


def test_bearing_noise_is_as_stated() -> None:
    """On an inclined wall a bearing error changes the range by r tan(incidence) times the error."""
    still = replace(square(), speed=1e-6)
    sigma = 0.002
    noisy = Simulation(still, duration=15.0, mount=(0, 0, 0), lidar=replace(QUIET, sigma_bearing=sigma))
    exact = Simulation(still, duration=15.0, mount=(0, 0, 0), lidar=QUIET)
    pairs = zip(*map(scans_of, (list(noisy), list(exact))), strict=True)
    scaled = []
    for a, b in pairs:
        incidence = np.abs((b.angles + np.pi / 4) % (np.pi / 2) - np.pi / 4)
        slanted = (incidence > 0.3) & (incidence < 0.7)  # not near the corners
        scaled.append(((a.ranges - b.ranges) / (b.ranges * np.tan(incidence)))[slanted])
    values = np.concatenate(scaled)
    assert np.std(values) == pytest.approx(sigma, rel=0.02)


def test_the_share_of_dropouts_is_as_stated() -> None:
    scans = scans_of(list(Simulation(square(), duration=15.0, lidar=replace(QUIET, dropouts=0.05))))
    invalid = np.isnan([scan.ranges for scan in scans])
    assert invalid.mean() == pytest.approx(0.05, abs=4 * np.sqrt(0.05 / invalid.size))


def test_mixed_pixels_lie_between_the_surfaces() -> None:
    lidar = replace(QUIET, mixed=1.0)
    mixed = scans_of(list(Simulation("columns", duration=5.0, lidar=lidar)))
    clean = scans_of(list(Simulation("columns", duration=5.0, lidar=QUIET)))
    found = 0
    for a, b in zip(mixed, clean, strict=True):
        beside = np.roll(b.ranges, -1)
        changed = np.flatnonzero(np.abs(a.ranges - b.ranges) > 1e-4)
        found += len(changed)
        low, high = np.minimum(b.ranges, beside)[changed], np.maximum(b.ranges, beside)[changed]
        assert np.all((a.ranges[changed] >= low - 1e-6) & (a.ranges[changed] <= high + 1e-6))
    assert found > len(mixed)


def test_a_wall_at_grazing_incidence_has_no_mixed_pixels() -> None:
    corners = np.array([[-30.0, -0.5], [30.0, -0.5], [30.0, 1.5], [-30.0, 1.5]])
    walls = np.hstack([corners, np.roll(corners, -1, axis=0)])
    hall = replace(square(), segments=walls, waypoints=np.array([[0.0, 0.0], [10.0, 0.0]]))
    mixed = scans_of(list(Simulation(hall, duration=3.0, lidar=replace(QUIET, mixed=1.0))))
    clean = scans_of(list(Simulation(hall, duration=3.0, lidar=QUIET)))
    for a, b in zip(mixed, clean, strict=True):
        np.testing.assert_array_equal(a.ranges, b.ranges)


def test_slip_is_as_stated_and_biases_are_drawn_per_seed() -> None:
    wheels = replace(PERFECT, slip=0.01)
    straight = replace(square(100.0), waypoints=np.array([[0.0, 0.0], [40.0, 0.0]]))
    lidar, finals = replace(QUIET, beams=1, rate=1.0), []
    for seed in range(120):
        simulation = Simulation(straight, seed=seed, duration=3.0, wheels=wheels, lidar=lidar)
        messages = list(simulation)
        last = [message for message in messages if isinstance(message, Odometry)][-1]
        truth = truth_of(messages)
        finals.append(se2.between(truth[0.0], truth[last.stamp])[0] - last.pose[0])
    distance = np.hypot(*np.diff(simulation.trajectory.poses[:, :2], axis=0).T).sum()
    # Mean of two wheels, each with a variance of slip^2 per metre.
    assert np.std(finals) == pytest.approx(0.01 * np.sqrt(distance / 2), rel=0.25)  # four standard errors
    left = [Simulation("room", seed=seed).biases.left for seed in range(200)]
    assert np.std(left) == pytest.approx(0.02, rel=0.25)
    assert len(set(left)) == 200


def test_parameters_are_complete() -> None:
    parameters = Simulation("room", seed=9).parameters
    assert parameters["seed"] == 9
    assert set(parameters) == {"world", "seed", "duration", "lidar", "wheels", "mount", "biases"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in ("museum", "office", "room") else pytest.mark.slow)
        for name in world_names()
    ],
)
def test_worlds_can_be_driven_through(name: str) -> None:
    simulation = Simulation(name)
    poses = simulation.trajectory.poses[::5]
    for since, until in [(0.0, np.inf), *((shapes.since, shapes.until) for shapes in simulation.world.temporary)]:
        times = 5 * TIME_STEP * np.arange(len(poses))
        path = poses[(times >= since) & (times < until), :2]
        walls, circles = simulation.world.shapes_at(since)
        start, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
        share = np.clip(((path[:, None] - start) * along).sum(-1) / (along**2).sum(-1), 0, 1)
        gaps = np.linalg.norm(path[:, None] - start - share[..., None] * along, axis=-1)
        assert gaps.min() > ROBOT_RADIUS
        if len(circles):
            gaps = np.linalg.norm(path[:, None] - circles[:, :2], axis=-1) - circles[:, 2]
            assert gaps.min() > ROBOT_RADIUS
    assert poses[-1, :2] == pytest.approx(simulation.world.waypoints[-1], abs=0.1)


def test_a_scan_shows_the_shapes_of_its_time() -> None:
    screen = TemporaryShapes(2.0, 4.0, np.array([[-1.0, 2.0, 1.0, 2.0]]), np.zeros((0, 3)))
    still = replace(square(), speed=1e-6, temporary=(screen,))
    scans = scans_of(list(Simulation(still, duration=6.0, lidar=QUIET, mount=(0, 0, 0))))
    ahead = {scan.stamp: scan.ranges[np.abs(scan.angles - np.pi / 2).argmin()] for scan in scans}
    for stamp, distance in ahead.items():
        assert distance == pytest.approx(2.0 if 2.0 <= stamp < 4.0 else 5.0, abs=1e-3)


def test_office_has_a_realistic_length_and_duration() -> None:
    simulation = Simulation("office")
    distance = np.hypot(*np.diff(simulation.trajectory.poses[:, :2], axis=0).T).sum()
    assert 100 < distance < 150
    assert 200 < simulation.trajectory.duration < 320


def test_simulation_is_faster_than_real_time() -> None:
    warm_up()
    simulation = Simulation("office", duration=20.0)
    start = time.process_time()
    list(simulation)
    assert time.process_time() - start < 4.0


def test_way_points_are_repeated_for_long_durations() -> None:
    simulation = Simulation("room", duration=120.0)
    assert simulation.trajectory.duration == pytest.approx(120.0)
    assert np.hypot(*np.diff(simulation.trajectory.poses[:, :2], axis=0).T).sum() > 35
    there_and_back = Simulation(square(), duration=60.0)
    assert np.abs(there_and_back.trajectory.poses[:, :2]).max() < 1.5


@pytest.mark.parametrize(
    "arguments",
    [
        {"world": "nowhere"},
        {"world": "nowhere.toml"},
        {"duration": -1.0},
        {"duration": float("nan")},
        {"seed": -1},
        {"mount": (0.0, 0.0)},
        {"mount": (np.nan, 0.0, 0.0)},
        {"lidar": LidarModel(beams=0)},
        {"lidar": LidarModel(dropouts=2.0)},
        {"lidar": LidarModel(sigma_range=-0.01)},
        {"wheels": WheelModel(rate=0.0)},
    ],
)
def test_invalid_arguments_are_rejected(arguments: dict[str, object]) -> None:
    with pytest.raises(RecordingError) as caught:
        Simulation(**arguments)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_coinciding_way_points_do_not_block_the_simulation() -> None:
    world = replace(square(), waypoints=np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.0], [0.0, 0.0]]))
    assert Simulation(world, duration=5.0).trajectory.duration == pytest.approx(5.0)
    assert Simulation(world).trajectory.duration < 10.0


def test_named_world_is_read_from_its_file() -> None:
    assert load_world("room").segments.shape == (8, 4)

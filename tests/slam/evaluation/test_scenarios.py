"""Worlds and logs of the benchmarks have the defects and shapes that they are named after."""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Message, Odometry, Scan
from drivers.simulation import LidarModel, Simulation, load_world
from drivers.simulation.trajectory import follow_waypoints
from drivers.timing.beam_times import BeamTimes
from slam.evaluation.benchmarks.scenarios.buildings import random_building, room_with_boxes, turning_path, wide_hall
from slam.evaluation.benchmarks.scenarios.later_drives import later_drive, small_stranger
from slam.evaluation.benchmarks.scenarios.log_variants import (
    LogVariant,
    carry,
    chain,
    crop,
    disturb,
    fail_odometry,
    lose_scans,
    quantise,
    reverse_times,
    scatter_no_returns,
    stamp_late,
    thin,
)
from slam.evaluation.benchmarks.scenarios.recorded import recorded
from slam.evaluation.benchmarks.scenarios.world_variants import FAR, NEAR, add_crowd, bend, mirror


@cache
def drive() -> list[Message]:
    return list(Simulation("room", seed=1, duration=6.0, lidar=LidarModel(beams=360, rate=5.0)))


def changed(variant: LogVariant) -> list[Message]:
    return list(variant(iter(drive()), np.random.default_rng(0)))


def scans_of(messages: list[Message]) -> list[Scan]:
    return [message for message in messages if isinstance(message, Scan)]


def test_cropped_scans_look_ahead_and_start_with_their_first_beam() -> None:
    for scan, whole in zip(scans_of(changed(crop(math.pi / 2))), scans_of(drive()), strict=True):
        assert len(scan.ranges) == 181
        np.testing.assert_allclose(scan.angles[[0, -1]], [-math.pi / 2, math.pi / 2], atol=1e-5)
        assert scan.time_offsets[0] == 0.0
        assert scan.stamp == pytest.approx(whole.stamp + 90 * whole.time_offsets[1])


def test_messages_remain_in_time_order() -> None:
    for variant in (crop(1.0), stamp_late(0.05), thin(), chain(thin(), stamp_late(1.0))):
        assert all(a.stamp <= b.stamp for a, b in pairwise(changed(variant)))
    late, original = scans_of(changed(stamp_late(0.05))), scans_of(drive())
    np.testing.assert_allclose([a.stamp - b.stamp for a, b in zip(late, original, strict=True)], 0.05)


def test_ranges_are_disturbed_as_stated() -> None:
    before = np.concatenate([scan.ranges for scan in scans_of(drive())])
    valid = np.isfinite(before)
    rounded = np.concatenate([scan.ranges for scan in scans_of(changed(quantise(0.01)))])
    np.testing.assert_allclose(rounded[valid] / 0.01, np.round(rounded[valid] / 0.01), atol=1e-6)
    np.testing.assert_allclose(rounded, before, atol=0.00501)
    added = np.concatenate([scan.ranges for scan in scans_of(changed(disturb(0.05, 0.05)))]) - before
    assert set(np.round(added[valid], 6)) == {0.0, 0.05}
    assert np.mean(added[valid] > 0) == pytest.approx(0.05, abs=0.01)


def test_odometry_fails_in_both_ways_and_goes_on() -> None:
    readings: list[Message] = [Odometry(0.1 * k, np.array([0.05 * k, 0.0, 0.0])) for k in range(20_000)]
    found = [
        (m.stamp, m.pose[0]) for m in fail_odometry()(readings, np.random.default_rng(1)) if isinstance(m, Odometry)
    ]
    stamps, x = np.array(found).T
    gaps, moved = np.diff(stamps) > 1.0, np.diff(x)
    assert 5.0 < np.diff(stamps)[gaps].min() < np.diff(stamps)[gaps].max() < 40.2
    np.testing.assert_allclose(
        moved[gaps], 0.5 * np.diff(stamps)[gaps], atol=1e-9
    )  # in a gap the wheels go on counting
    stands = moved == 0.0
    assert 0.05 < stands.mean() < 0.4
    np.testing.assert_allclose(moved[~gaps & ~stands], 0.05, atol=1e-9)


def test_scans_are_missing_again_and_again_and_odometry_is_not() -> None:
    sent: list[Message] = []
    for stamp in 0.1 * np.arange(20_000):
        sent += [Odometry(stamp, np.zeros(3)), Scan(stamp, np.ones(1), np.zeros(1), np.zeros(1), 0.1, 8.0)]
    found = list(lose_scans()(sent, np.random.default_rng(1)))
    assert sum(isinstance(m, Odometry) for m in found) == len(sent) // 2
    between = np.diff([scan.stamp for scan in scans_of(found)])
    missing = between[between > 0.2]
    assert 5.0 < missing.min() < missing.max() < 40.2
    assert 0.05 < missing.sum() / between.sum() < 0.4


def test_a_carried_robot_sends_nothing_meanwhile_and_its_odometry_starts_anew() -> None:
    sent: list[Message] = []
    for stamp in 0.1 * np.arange(20_000):
        pose = np.array([5.0 * stamp, 0.0, 0.0])
        sent += [Odometry(stamp, pose), Scan(stamp, np.ones(1), np.zeros(1), np.zeros(1), 0.1, 8.0)]
    found = list(carry()(sent, np.random.default_rng(1)))
    odometry = [message for message in found if isinstance(message, Odometry)]
    assert [scan.stamp for scan in scans_of(found)] == [reading.stamp for reading in odometry]
    between, moved = np.diff([one.stamp for one in odometry]), np.diff([one.pose[0] for one in odometry])
    gaps = between > 0.2
    assert 5.0 < between[gaps].min() < between[gaps].max() < 40.2
    np.testing.assert_allclose([odometry[row + 1].pose for row in np.flatnonzero(gaps)], 0.0)
    np.testing.assert_allclose(moved[~gaps], 0.5)


def test_thinned_logs_have_few_scans_and_all_odometry() -> None:
    messages = changed(thin(0.5, math.radians(30)))
    poses, last = [], np.zeros(3)
    for message in messages:
        if isinstance(message, Odometry):
            last = message.pose
        elif isinstance(message, Scan):
            poses.append(last)
    moved = [se2.between(a, b) for a, b in pairwise(poses)]
    assert len(moved) > 2
    assert all(math.hypot(m[0], m[1]) >= 0.5 or abs(m[2]) >= math.radians(30) for m in moved)
    assert sum(isinstance(m, Odometry) for m in messages) == sum(isinstance(m, Odometry) for m in drive())


def test_defects_of_recordings_are_corrected_by_the_reader() -> None:
    original = scans_of(drive())
    with recorded(scatter_no_returns()(iter(drive()), np.random.default_rng(0))) as reader:
        read = scans_of(list(reader))
    for scan, before in zip(read, original, strict=True):
        np.testing.assert_array_equal(np.isnan(scan.ranges), np.isnan(before.ranges))
    with recorded(reverse_times()(iter(drive()), np.random.default_rng(0))) as reader:
        reader.set_beam_times = BeamTimes(reversed=True)
        first = next(message for message in reader if isinstance(message, Scan))
    np.testing.assert_allclose(first.time_offsets, original[0].time_offsets, atol=1e-9)


def test_a_mirrored_world_is_no_rotated_one() -> None:
    world, mirrored = load_world("moved_furniture"), mirror(load_world("moved_furniture"))
    assert mirror(mirrored).segments.tolist() == world.segments.tolist()
    assert mirrored.temporary[0].segments[0, 1] == -world.temporary[0].segments[0, 1]

    def turn(path: np.ndarray) -> float:
        legs = np.diff(path, axis=0)
        return float(np.sum(se2.wrap(np.diff(np.arctan2(legs[:, 1], legs[:, 0])))))

    assert turn(mirrored.waypoints) == pytest.approx(-turn(world.waypoints))


def test_bent_walls_deviate_by_the_stated_amount_in_waves() -> None:
    long_wall = load_world("corridor")
    segments = np.tile([0.0, 0.0, 20.0, 0.0], (40, 1))
    straight = type(long_wall)("wall", "wall", segments, np.zeros((0, 3)), long_wall.waypoints, 0.5)
    nodes = bend(straight, 0.003, 2.0, np.random.default_rng(1)).segments
    np.testing.assert_array_equal(nodes[1:80, :2], nodes[:79, 2:])
    assert np.std(nodes[:, 1]) == pytest.approx(0.003, rel=0.15)
    upward = np.sum((nodes[:, 1] < 0) & (nodes[:, 3] >= 0))
    assert 40 * 20.0 / upward == pytest.approx(2.0, rel=0.2)


def test_people_surround_the_robot_while_it_drives() -> None:
    world = add_crowd(load_world("room"), 8, np.random.default_rng(2), duration=5.0)
    path = follow_waypoints(world.waypoints, world.speed, 5.0)
    for time in (0.05, 2.5, 4.9):
        _, people = world.shapes_at(time)
        distance = np.hypot(*(people[:, :2] - path.poses_at(np.array([time]))[0, :2]).T)
        assert len(people) == 8
        assert np.all((distance > NEAR - 0.2) & (distance < FAR + 0.2))


@pytest.mark.parametrize(
    "world",
    [
        random_building(0),
        *(pytest.param(random_building(seed), marks=pytest.mark.slow) for seed in range(1, 6)),
        *map(room_with_boxes, range(3)),
    ],
)
def test_robot_reaches_the_end_of_a_random_building_without_touching_anything(world: object) -> None:
    free_drive(world)


def test_robot_reaches_the_end_of_the_other_buildings() -> None:
    for world in (wide_hall(), turning_path()):
        free_drive(world)


def free_drive(world: object) -> None:
    """Assert that a drive ends at the last way point and keeps 0.3 m from all walls."""
    path = follow_waypoints(world.waypoints, world.speed).poses  # type: ignore[attr-defined]
    np.testing.assert_allclose(path[-1, :2], world.waypoints[-1], atol=0.1)  # type: ignore[attr-defined]
    ends = world.segments.reshape(-1, 2, 2)  # type: ignore[attr-defined]
    along = ends[:, 1] - ends[:, 0]
    for position in path[::25, :2]:
        share = np.clip(np.sum((position - ends[:, 0]) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
        assert np.hypot(*(ends[:, 0] + share[:, None] * along - position).T).min() > 0.3


def test_a_building_is_drawn_from_its_seed() -> None:
    assert random_building(4).segments.tolist() == random_building(4).segments.tolist()
    assert random_building(4).segments.tolist() != random_building(5).segments.tolist()


@pytest.mark.parametrize(
    # an office, a building of corridors, and rooms with boxes
    "seed",
    [6000, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (6004, 6007))],
)
def test_a_refurnished_building_has_the_same_walls_and_other_furniture(seed: int) -> None:
    earlier = small_stranger(seed)
    later = later_drive(earlier, refurnished=True).simulation
    before, after = ({tuple(s) for s in world.segments.tolist()} for world in (earlier.world, later.world))
    assert max(map(_length, before & after)) == max(map(_length, before))
    assert _length(max(before - after, key=_length)) < 3.5
    assert len(before - after) > 30 < len(after - before)
    np.testing.assert_array_equal(earlier.world.waypoints, later.world.waypoints)
    assert earlier.lidar == later.lidar
    free_drive(later.world)
    assert later_drive(earlier).simulation.world is earlier.world


def _length(segment: tuple[float, ...]) -> float:
    return math.hypot(segment[2] - segment[0], segment[3] - segment[1])


def test_a_lidar_sees_nothing_in_the_middle_of_the_wide_hall() -> None:
    world = wide_hall()
    path = follow_waypoints(world.waypoints, world.speed).poses[::50, :2]
    ends = world.segments.reshape(-1, 2, 2)
    middle = path[(np.abs(path[:, 0] - 15) < 1) & (np.abs(path[:, 1] - 11) < 1)]
    assert len(middle)
    assert np.hypot(*(ends.reshape(-1, 1, 2) - middle).transpose(2, 0, 1)).min() > 6.0

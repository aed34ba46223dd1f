"""Odometry history: interpolation and order of the readings, and paths along them."""

from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry
from slam.odometry.history import MIN_MOTION_TRAVEL, OdometryHistory, wheel_travel

from ...traced_memory import traced_memory
from .arcs import driven, history_of, twists_of
from .circle import circle_history, pose_on_circle


def test_poses_are_interpolated_between_readings_and_constant_outside() -> None:
    history = circle_history()
    for stamp in (0.0, 0.05, 0.3, 0.512, 1.9):
        np.testing.assert_allclose(history.at(stamp), pose_on_circle(stamp), atol=2e-3)
    np.testing.assert_array_equal(history.at(-1.0), history.poses[0])
    np.testing.assert_array_equal(history.at(99.0), history.poses[-1])
    assert history.at_each(np.array([0.1, 0.2])).shape == (2, 3)
    assert history.at_each(np.zeros(0)).shape == (0, 3)


def test_headings_are_interpolated_the_shorter_way_round() -> None:
    history = OdometryHistory()
    history.add(Odometry(0.0, np.array([0.0, 0.0, 3.1])))
    history.add(Odometry(1.0, np.array([0.0, 0.0, -3.1])))
    assert abs(history.at(0.5)[2]) == pytest.approx(np.pi)


def test_a_reading_not_later_than_the_last_replaces_its_pose() -> None:
    history = OdometryHistory()
    assert history.latest == -np.inf
    for stamp, x in ((0.0, 0.0), (1.0, 1.0), (1.0, 2.0), (0.5, 3.0)):
        history.add(Odometry(stamp, np.array([x, 0.0, 0.0])))
    np.testing.assert_array_equal(history.stamps, [0.0, 1.0])
    np.testing.assert_array_equal(history.poses[:, 0], [0.0, 3.0])


def test_poses_at_several_stamps_are_those_at_each() -> None:
    history = circle_history()
    stamps = np.concatenate([history.stamps[::7], history.stamps[1::5] + 0.003, [-1.0, 99.0, 0.512]])
    np.testing.assert_array_equal(history.at_each(stamps), [history.at(stamp) for stamp in stamps.tolist()])


def test_a_copy_does_not_change_with_the_history() -> None:
    history = circle_history()
    other, poses = history.copy(), history.poses
    history.add(Odometry(history.latest, np.zeros(3)))
    history.add(Odometry(history.latest + 1.0, np.ones(3)))
    assert len(other) == len(poses) == len(history) - 1
    np.testing.assert_array_equal(other.poses, poses)


def test_a_copy_takes_no_memory_for_the_readings() -> None:
    """Each save of a live run copies them, which are more the longer the robot drives."""
    history = OdometryHistory.from_arrays(np.arange(100_000.0), np.zeros((100_000, 3)))
    with traced_memory() as memory:
        copy = history.copy()
    assert memory.peak < 0.01 * copy.poses.nbytes


def test_memory_of_a_reading_is_four_numbers() -> None:
    history = OdometryHistory()
    with traced_memory() as memory:
        for k in range(10_000):
            history.add(Odometry(float(k), np.array([k, 0.0, 0.0])))
    assert memory.kept < 10_000 * 4 * 8 * 1.2


def test_poses_at_few_stamps_need_little_memory_whatever_the_length_of_the_history() -> None:
    history = OdometryHistory.from_arrays(np.arange(100_000.0), np.zeros((100_000, 3)))
    with traced_memory() as memory:
        history.at_each(np.array([70_000.2, 70_001.5, 70_003.0]))
    assert memory.peak < 20_000


def test_travel_does_not_depend_on_the_blocks_in_which_it_is_summed(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = circle_history().travelled
    monkeypatch.setattr("slam.odometry.history.BLOCK", 3)
    np.testing.assert_array_equal(circle_history().travelled, whole)
    assert not len(OdometryHistory().travelled)


def path_with_stops(random: np.random.Generator) -> OdometryHistory:
    """Return jittering readings of a robot that stands, drives along arcs, turns in place, and stands, twice."""
    arcs = [np.zeros((500, 3)), twists_of([(1.0, 0.0), (1.0, 1.5), (0.0, -2.0)])]
    poses = driven(np.concatenate([*arcs, *arcs, arcs[0]]))
    return history_of(poses + random.normal(0.0, [0.003, 0.003, 0.005], poses.shape))


def ends_of(history: OdometryHistory, begin: int = 0, end: int = -1) -> tuple[Odometry, Odometry]:
    """Return two of the readings."""
    first, last = (Odometry(float(history.stamps[row]), history.poses[row]) for row in (begin, end))
    return first, last


def test_a_path_leads_from_its_begin_to_its_end_in_parts_that_are_no_jitter() -> None:
    history = path_with_stops(np.random.default_rng(0))
    begin, end = ends_of(history)
    path = history.path(begin, end)
    np.testing.assert_array_equal(path[0], begin.pose)
    np.testing.assert_array_equal(path[-1], end.pose)
    travel = wheel_travel(se2.between(path[:-1], path[1:]))
    assert travel[:-1].min() >= MIN_MOTION_TRAVEL
    assert travel.max() < 1.5 * MIN_MOTION_TRAVEL
    rows = [int(np.flatnonzero((history.poses == node).all(axis=1))[0]) for node in path[1:-1]]
    assert rows == sorted(rows)
    driving = len(twists_of([(1.0, 0.0), (1.0, 1.5), (0.0, -2.0)]))
    stands = (np.array(rows) + 1) % (500 + driving) < 490
    assert np.count_nonzero(stands) <= 4  # the first ones after stopping; a robot that stands adds none


def test_a_path_between_two_poses_beside_the_readings_contains_those_in_between() -> None:
    history = path_with_stops(np.random.default_rng(0))
    whole = history.path(*ends_of(history))
    begin, end = Odometry(15.003, np.array([9.0, 0.0, 0.0])), Odometry(30.001, np.array([0.0, 9.0, 1.0]))
    path = history.path(begin, end)
    np.testing.assert_array_equal(path[[0, -1]], [begin.pose, end.pose])
    stamps = np.array([history.stamps[(history.poses == node).all(axis=1)][0] for node in whole[1:-1]])
    np.testing.assert_array_equal(path[1:-1], whole[1:-1][(stamps > begin.stamp) & (stamps < end.stamp)])
    np.testing.assert_array_equal(history.path(begin, begin), [begin.pose, begin.pose])
    np.testing.assert_array_equal(OdometryHistory().path(begin, end), [begin.pose, end.pose])


def test_a_path_does_not_depend_on_later_readings_nor_on_when_it_was_asked_for() -> None:
    history, growing = path_with_stops(np.random.default_rng(0)), OdometryHistory()
    begin, end = ends_of(history, 3, 900)
    for count, (stamp, pose) in enumerate(zip(history.stamps.tolist(), history.poses, strict=True)):
        growing.add(Odometry(stamp, pose))
        if count % 7 == 0:
            growing.path(begin, Odometry(stamp, pose))
        if count == 900:
            np.testing.assert_array_equal(growing.path(begin, end), history.path(begin, end))
    np.testing.assert_array_equal(growing.path(begin, end), history.path(begin, end))
    np.testing.assert_array_equal(growing.path(*ends_of(history)), history.path(*ends_of(history)))
    np.testing.assert_array_equal(growing.copy().path(*ends_of(history)), history.path(*ends_of(history)))


def test_a_reading_that_was_replaced_is_not_on_the_path() -> None:
    history, expected = OdometryHistory(), OdometryHistory()
    for k in range(40):
        pose = np.array([0.03 * k, 0.0, 0.0])
        reading, late = Odometry(0.1 * k, pose), Odometry(0.1 * k - 0.05, pose + np.array([0.0, 0.1, 0.0]))
        history.add(reading)
        history.path(Odometry(0.0, np.zeros(3)), reading)
        if k % 3 == 2:
            history.add(late)
        expected.add(replace(late, stamp=reading.stamp) if k % 3 == 2 else reading)
    np.testing.assert_array_equal(history.path(*ends_of(expected)), expected.path(*ends_of(expected)))


def test_a_path_leads_along_readings_that_were_added_before_the_first() -> None:
    history = circle_history()
    begin = Odometry(-1.5, pose_on_circle(-1.5))
    end = Odometry(1.5, pose_on_circle(1.5))
    assert len(history.path(begin, end)) < 20
    history.extend_back(begin.stamp)
    path = history.path(begin, end)
    expected = OdometryHistory.from_arrays(history.stamps, history.poses).path(begin, end)
    np.testing.assert_array_equal(path, expected)
    assert len(path) > 25
    assert wheel_travel(se2.between(path[:-1], path[1:])).max() < 0.2


def test_a_path_through_joined_histories_leads_through_all_of_them() -> None:
    history = path_with_stops(np.random.default_rng(0))
    stamps, poses, half = history.stamps, history.poses, 700
    parts = [OdometryHistory.from_arrays(stamps[rows], poses[rows]) for rows in (slice(half), slice(half, None))]
    ends = ends_of(history)
    np.testing.assert_array_equal(OdometryHistory.joined(parts).path(*ends), history.path(*ends))
    assert len(OdometryHistory.joined([])) == 0
    assert len(parts[0]) == half

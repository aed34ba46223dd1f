"""Consistency of the covariances over simulated drives with ground truth."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.simulation import Simulation, World
from slam.evaluation.benchmarks.consistency import consistency_table, simulate, summarise
from slam.evaluation.ground_truth import Nees, TrueWalls, corner_nees, match_walls, measure, true_walls, wall_nees
from slam.mapping.map_features import MapCorners, MapWalls
from slam.odometry.history import OdometryHistory
from slam.preprocessing.deskew import deskew


def lines(*frames: tuple[float, float, float], half: float = 0.5) -> MapWalls:
    count = len(frames)
    covariance = np.tile(np.diag([0.01, 0.01]) ** 2, (count, 1, 1))
    extent = np.full(count, half)
    pieces = tuple(np.column_stack([-extent, extent])[:, None])
    return MapWalls(np.arange(count), np.array(frames), -extent, extent, np.ones(count, int), covariance, pieces)


@pytest.fixture
def world() -> TrueWalls:
    """Return two parts of one wall with a door between them and a perpendicular wall, in the frame at (1, 1)."""
    segments = np.array([[0.0, 0.0, 3.0, 0.0], [4.0, 0.0, 6.0, 0.0], [0.0, 0.0, 0.0, 5.0]])
    place = World("test", "test", segments, np.zeros((0, 3)), np.zeros((2, 2)), 1.0)
    return true_walls(place, np.array([1.0, 1.0, 0.0]))


def test_walls_are_matched_with_the_side_they_are_seen_from(world: TrueWalls) -> None:
    mapped = lines((0.5, -1.0, 0.0), (0.5, -1.0, np.pi), (0.5, -0.5, 0.0), (0.5, -1.0, 0.5), (-1.0, 1.0, -np.pi / 2))
    np.testing.assert_array_equal(match_walls(mapped, world), [0, 3, -1, -1, 5])


def test_a_wall_mapped_across_a_door_is_matched(world: TrueWalls) -> None:
    assert match_walls(lines((2.0, -1.0, 0.0), half=2.5), world)[0] in (0, 1)
    assert match_walls(lines((2.5, -1.0, 0.0), half=0.4), world)[0] == -1  # in the door


def test_the_nees_is_the_squared_error_in_standard_deviations(world: TrueWalls) -> None:
    mapped = lines((0.5, -0.98, 0.0), (0.5, -1.0, 0.02), (9.0, 9.0, 0.0), (-1.02, 1.0, -np.pi / 2))
    np.testing.assert_allclose(wall_nees(mapped, world), [4.0, 4.0, np.nan, 4.0], atol=0.01)
    corners = MapCorners(
        identity=np.arange(3),
        position=np.array([[-1.0, -0.97], [-1.0, -0.5], [-1.0, -1.0]]),
        covariance=np.tile(1e-4 * np.eye(2), (3, 1, 1)),
        walls=np.array([[3, 0], [3, 0], [3, 2]]),
        observations=np.ones(3, int),
    )
    np.testing.assert_allclose(corner_nees(corners, mapped, world), [9.0, np.nan, np.nan], atol=1e-6)


def test_short_drives_are_consistent_within_a_wide_band() -> None:
    runs = list(simulate(range(3), duration=40.0))
    assert np.isfinite(np.concatenate([run.walls for run in runs])).mean() > 0.8
    for row in summarise(runs):
        mean = row.consistency.mean / row.consistency.dimensions
        assert 0.25 < mean < 3.0, f"{row.name}: {mean:.2f}"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_hundred_drives_with_the_lidar_off_centre_and_turned_are_consistent() -> None:
    rows = summarise(list(simulate(range(100))))
    assert all(row.consistency.consistent for row in rows), "\n".join(consistency_table(rows))


def test_the_table_marks_inconsistent_rows() -> None:
    random = np.random.default_rng(0)
    runs = [Nees(*(random.chisquare(k, 20) * share for k, share in ((3, 1.0), (2, 2.0), (2, 0.5)))) for _ in range(100)]
    lines = consistency_table(summarise(runs))
    verdicts = {line[:9].strip(): line.rsplit("  ", 1)[-1] for line in lines[1:]}
    assert verdicts["walls"] == "overconfident"
    assert verdicts["corners"] == "too cautious"
    assert verdicts["poses"].strip() == verdicts["last pose"].strip() == "100"


def test_deskewing_ignores_encoder_jitter_at_standstill() -> None:
    simulation = Simulation("office", seed=1, duration=1.0)
    odometry = OdometryHistory()
    messages = list(simulation)
    for message in messages:
        if isinstance(message, Odometry):
            odometry.add(message)
    assert np.ptp(odometry.poses[:, 2]) > 5e-4  # the encoders do jitter
    for message in messages:
        if isinstance(message, Scan) and message.stamp < 0.8:
            sweep = deskew(message, odometry, simulation.mount)
            np.testing.assert_array_equal(sweep.bearings, message.angles)
            np.testing.assert_array_equal(sweep.ranges, message.ranges)


def test_the_first_keyframe_defines_the_map() -> None:
    simulation = Simulation("room", duration=6.0)
    nees, finished = measure(simulation)
    assert len(nees.poses) == len(finished.keyframes) - 1
    truth = simulation.trajectory.poses_at(finished.keyframe_stamps)
    difference = se2.between(se2.between(truth[0], truth), finished.keyframes)
    np.testing.assert_allclose(difference[0], 0.0, atol=1e-3)
    assert np.abs(difference[:, :2]).max() < 0.01

"""Whether covariances are honest: errors in units of them, over simulated drives where the truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from drivers.simulator import Simulation
from drivers.world import World
from slam.events import MapCorners, MapLines
from slam.ground_truth import Nees, TrueWalls, corner_nees, match_walls, measure, true_walls, wall_nees


def lines(*frames: tuple[float, float, float], half: float = 0.5) -> MapLines:
    count = len(frames)
    covariance = np.tile(np.diag([0.01, 0.01]) ** 2, (count, 1, 1))
    extent = np.full(count, half)
    pieces = tuple(np.column_stack([-extent, extent])[:, None])
    return MapLines(np.arange(count), np.array(frames), -extent, extent, np.ones(count, int), covariance, pieces)


@pytest.fixture
def world() -> TrueWalls:
    """Two pieces of one wall with a door between them, another one across, seen from (1, 1) in the world."""
    segments = np.array([[0.0, 0.0, 3.0, 0.0], [4.0, 0.0, 6.0, 0.0], [0.0, 0.0, 0.0, 5.0]])
    place = World("test", "test", segments, np.zeros((0, 3)), np.zeros((2, 2)), 1.0)
    return true_walls(place, np.array([1.0, 1.0, 0.0]))


def test_walls_are_matched_with_the_side_they_are_seen_from(world: TrueWalls) -> None:
    mapped = lines((0.5, -1.0, 0.0), (0.5, -1.0, np.pi), (0.5, -0.5, 0.0), (0.5, -1.0, 0.5), (-1.0, 1.0, -np.pi / 2))
    np.testing.assert_array_equal(match_walls(mapped, world), [0, 3, -1, -1, 5])


def test_a_wall_mapped_across_a_door_is_that_wall(world: TrueWalls) -> None:
    assert match_walls(lines((2.0, -1.0, 0.0), half=2.5), world)[0] in (0, 1)
    assert match_walls(lines((2.5, -1.0, 0.0), half=0.4), world)[0] == -1  # in the door


def test_errors_are_counted_in_standard_deviations(world: TrueWalls) -> None:
    mapped = lines((0.5, -0.98, 0.0), (0.5, -1.0, 0.02), (9.0, 9.0, 0.0), (-1.02, 1.0, -np.pi / 2))
    np.testing.assert_allclose(wall_nees(mapped, world), [4.0, 4.0, np.nan, 4.0], atol=0.01)
    corners = MapCorners(
        identity=np.arange(3),
        position=np.array([[-1.0, -0.97], [-1.0, -0.5], [-1.0, -1.0]]),
        covariance=np.tile(1e-4 * np.eye(2), (3, 1, 1)),
        lines=np.array([[3, 0], [3, 0], [3, 2]]),
        observations=np.ones(3, int),
    )
    np.testing.assert_allclose(corner_nees(corners, mapped, world), [9.0, np.nan, np.nan], atol=1e-6)


def pooled(runs: list[Nees]) -> dict[str, float]:
    """Mean NEES by degree of freedom; 1 is perfect, more is overconfident."""
    poses, walls, corners = (
        np.concatenate([getattr(run, kind) for run in runs]) for kind in ("poses", "walls", "corners")
    )
    return {"poses": poses.mean() / 3, "walls": np.nanmean(walls) / 2, "corners": np.nanmean(corners) / 2}


def test_short_drives_are_consistent_within_a_wide_band() -> None:
    runs = [measure(Simulation("office", seed=seed, duration=60.0))[0] for seed in range(3)]
    assert np.isfinite(np.concatenate([run.walls for run in runs])).mean() > 0.8
    for kind, mean in pooled(runs).items():
        assert 0.25 < mean < 3.0, f"{kind}: {mean:.2f}"


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_thirty_drives_are_consistent() -> None:
    runs = [measure(Simulation("office", seed=seed))[0] for seed in range(30)]
    for kind, mean in pooled(runs).items():
        assert 0.7 < mean < 1.5, f"{kind}: {mean:.2f}"


def test_the_first_keyframe_defines_the_map() -> None:
    simulation = Simulation("room", duration=6.0)
    nees, finished = measure(simulation)
    assert len(nees.poses) == len(finished.keyframes) - 1
    truth = simulation.path.at(finished.keyframe_stamps)
    difference = se2.between(se2.between(truth[0], truth), finished.keyframes)
    np.testing.assert_allclose(difference[0], 0.0, atol=1e-3)
    assert np.abs(difference[:, :2]).max() < 0.01

"""Consistency of the covariances over simulated drives with ground truth."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.simulation import Simulation, World
from slam.evaluation.benchmarks.consistency import consistency_table, simulate, summarise
from slam.evaluation.benchmarks.consistency_conditions import CONDITIONS
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
    runs = list(simulate(range(3), duration=15.0))
    assert np.isfinite(np.concatenate([run.walls for run in runs if run is not None])).mean() > 0.8
    result = summarise(runs)
    assert {row.name for row in result.rows} == {"poses", "last pose", "relative poses", "walls", "corners"}
    for row in result.rows:
        assert 0.25 < row.mean < 3.0, f"{row.name}: {row.mean:.2f}"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_hundred_drives_with_the_lidar_off_centre_and_turned_are_consistent() -> None:
    result = summarise(list(simulate(range(100))))
    assert all(row.verdict in ("inside", "undecided") for row in result.rows), "\n".join(consistency_table([result]))


def drawn(scales: tuple[float, float, float, float], runs: int = 100) -> list[Nees]:
    """Return drives with independent NEES values of poses, walls, corners and relative poses, times some scales."""
    random = np.random.default_rng(0)
    return [
        Nees(*(random.chisquare(k, 20) * scale for k, scale in zip((3, 2, 2, 3), scales, strict=True)))
        for _ in range(runs)
    ]


def test_the_table_marks_means_outside_the_band() -> None:
    result = summarise([*drawn((1.0, 2.0, 0.5, 1.3)), None])
    verdicts = {row.name: row.verdict for row in result.rows}
    assert (verdicts["walls"], verdicts["corners"]) == ("overconfident", "too cautious")
    assert verdicts["poses"] == verdicts["last pose"] == verdicts["relative poses"] == "inside"
    (line,) = consistency_table([result])[2:]
    assert "1 of 101 drives without a map" in line
    assert line.count("**") == 4
    assert line.endswith("| no |")
    assert consistency_table([summarise(drawn((1.0, 1.0, 1.0, 1.0)))])[2].endswith("| yes |")


def test_a_mean_outside_the_band_by_few_standard_errors_is_undecided() -> None:
    runs = [Nees(*(np.full(4, k * mean) for k in (3, 2, 2, 3))) for mean in (1.0, 2.2)]
    row = summarise(runs).rows[0]
    assert (row.mean, row.standard_error) == (pytest.approx(1.6), pytest.approx(0.6))
    assert (row.inside, row.verdict) == (False, "undecided")
    assert np.isnan(summarise(runs[:1]).rows[0].standard_error)


def test_gross_errors_are_counted() -> None:
    (run,) = drawn((1.0, 1.0, 1.0, 1.0), runs=1)
    run.walls[:5] = 100.0
    rows = {row.name: row for row in summarise([run]).rows}
    assert rows["walls"].gross == pytest.approx(0.25, abs=0.01)
    assert rows["poses"].gross < 0.1


def test_conditions_are_chosen_and_printed_as_one_line_of_json(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = []
    monkeypatch.setattr("slam.warmup.warm_up", lambda: None)

    def simulated(numbers: range, *_: object, **__: object) -> Any:
        seeds.extend(numbers)
        return iter(drawn((1.0, 1.0, 1.0, 1.0), runs=2))

    monkeypatch.setattr("slam.evaluation.benchmarks.consistency.simulate", simulated)
    options = ("--condition", "bent-walls", "--condition", "boxes", "--first-seed", "40", "--seeds", "2", "--json")
    result = wclm("bench", "consistency", *options)
    assert result.exit_code == 0, result.output
    assert len(result.stdout.splitlines()) == 1
    content = json.loads(result.stdout)
    assert [row["condition"] for row in content["conditions"]] == ["bent-walls", "boxes"]
    assert content["conditions"][0]["nees"]["walls"]["verdict"] == "inside"
    assert seeds == [40, 41, 40, 41]
    wclm.refuses("bench", "consistency", "--condition", "moon", because=["moon", "no such condition", "bent-walls"])
    text = " ".join(wclm("bench", "consistency", "--help").output.replace("│", " ").split())
    assert all(name in text for name in CONDITIONS)


@pytest.mark.parametrize(
    "condition",
    [
        "half-circle",
        pytest.param("bent-walls", marks=pytest.mark.slow),
        pytest.param("buildings", marks=pytest.mark.slow),
    ],
)
def test_drives_that_are_not_in_the_office_as_it_is_are_scored(condition: str) -> None:
    (run,) = simulate([3], 3.5, condition)
    assert run is not None
    assert np.nanmedian(run.walls) < 100.0
    assert np.median(run.poses) < 100.0


def test_a_drive_without_a_map_is_counted() -> None:
    result = summarise(list(simulate([3], 0.01)))
    assert (result.drives, result.failed, result.rows) == (1, 1, ())
    assert consistency_table([result])[-1].endswith("| no |")


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
    truth = simulation.trajectory.poses_at(finished.keyframes.stamps)
    difference = se2.between(se2.between(truth[0], truth), finished.keyframes.poses)
    np.testing.assert_allclose(difference[0], 0.0, atol=1e-3)
    assert np.abs(difference[:, :2]).max() < 0.01

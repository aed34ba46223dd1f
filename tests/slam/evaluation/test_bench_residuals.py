"""Residuals of recordings, and comparison of the maps of two halves of a drive."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from drivers import se2
from drivers.simulation import LidarModel, Simulation
from slam.config import Config
from slam.errors import MapError
from slam.evaluation.benchmarks.residuals import (
    RecordingConsistency,
    ResidualStatistics,
    examine,
    residual_statistics,
    residual_table,
)
from slam.mapping.map_features import MapWalls
from slam.offline.wall_alignment import align_maps


def test_independent_residuals_have_no_correlation_and_shared_errors_show() -> None:
    random = np.random.default_rng(1)
    white = [random.standard_normal(200) for _ in range(40)]
    found = residual_statistics(white)
    assert found.count == 8000
    assert found.rms == pytest.approx(1.0, abs=0.03)
    assert found.correlation == pytest.approx(1.0, abs=0.4)
    blurred = [np.convolve(one, np.ones(4) / 2.0, mode="valid") for one in white]  # 1 + 2 (3 + 2 + 1) / 4
    assert residual_statistics(blurred).correlation == pytest.approx(4.0, abs=0.8)
    assert residual_statistics([3.0 * one for one in white]).rms == pytest.approx(3.0, abs=0.1)


def test_series_shorter_than_the_lags_are_used_as_far_as_they_go() -> None:
    assert residual_statistics([np.array([1.0, 1.0]), np.array([1.0])]).correlation == pytest.approx(3.0)
    assert np.isnan(residual_statistics([]).rms)


def walls_of(frames: Any, half: float = 2.0) -> MapWalls:
    count = len(frames)
    extent = np.full(count, half)
    pieces = tuple(np.column_stack([-extent, extent])[:, None])
    none = np.zeros((count, 2, 2))
    return MapWalls(np.arange(count), np.array(frames), -extent, extent, np.ones(count, int), none, pieces)


def test_maps_are_aligned_by_their_common_walls_whatever_the_others_are() -> None:
    random = np.random.default_rng(2)
    turns = np.pi / 2 * random.integers(0, 4, 12)
    frames = np.column_stack([random.uniform(-20.0, 20.0, (12, 2)), turns + 0.05 * random.standard_normal(12)])
    motion = np.array([3.0, -2.0, 0.7])
    moved = se2.compose(se2.inverse(motion), frames)
    moved = se2.compose(moved, np.column_stack([random.uniform(-1.0, 1.0, 12), np.zeros((12, 2))]))  # along the wall
    moved[0] = se2.compose(moved[0], [0.0, 0.15, 0.0])  # another wall
    others = np.vstack([moved[::-1], [[90.0, 90.0, 0.0]]])
    guess = se2.compose(motion, [0.2, -0.1, 0.03])
    found, pairs = align_maps(walls_of(frames), walls_of(others), guess)
    np.testing.assert_allclose(found, motion, atol=0.01)
    assert len(pairs) >= 11
    assert all(one + two == 11 for one, two in pairs)


@pytest.mark.slow
@pytest.mark.parametrize("range_bias", [0.0, 0.02])
def test_halves_of_a_simulated_drive_are_consistent(range_bias: float) -> None:
    lidar = LidarModel(beams=180, rate=5.0, range_bias=range_bias)
    result = examine("room", list(Simulation("room", seed=5, duration=45.0, lidar=lidar)), Config())
    assert result.heading.count == result.offset.count > 50
    assert 0.3 < result.heading.rms < 1.3
    assert -0.5 < result.offset.correlation < 1.5
    assert result.halves is not None
    assert result.halves.common >= 4
    assert 0.1 < result.halves.nees < 3.0
    assert 0.1 < result.halves.median < 3.0
    assert result.halves.gross < 0.2


def test_halves_without_common_walls_are_left_out() -> None:
    result = examine("short", list(Simulation("room", duration=3.0, lidar=LidarModel(beams=90))), Config())
    assert result.halves is None
    assert residual_table([result])[-1].endswith("| - | - | - | - |")
    with pytest.raises(MapError):
        examine("empty", [], Config())


def test_the_command_prints_one_line_of_json(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    statistics = ResidualStatistics(10, 1.1, 2.5)
    monkeypatch.setattr("slam.warmup.warm_up", lambda: None)
    monkeypatch.setattr(
        "slam.evaluation.benchmarks.residuals.examine",
        lambda name, messages, config: RecordingConsistency(name, statistics, statistics, None),
    )
    result = wclm("bench", "residuals", "sim:room?duration=1", "--json")
    assert len(result.stdout.splitlines()) == 1
    (row,) = json.loads(result.stdout)["recordings"]
    assert (row["name"], row["heading"]["correlation"], row["halves"]) == ("sim:room?duration=1", 2.5, None)
    wclm.refuses("bench", "residuals", "gone.clf", because=["gone.clf"])

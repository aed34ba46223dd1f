"""The range bias is an unknown of the graph, and a configured one is subtracted before anything else."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from drivers.messages import Scan
from drivers.simulation import LidarModel, Simulation
from slam.config import Config, LidarConfig
from slam.errors import MapError
from slam.evaluation.benchmarks.consistency import calibrated_config, simulate, summarise
from slam.evaluation.ground_truth import measure
from slam.graph.array_graph import ArrayGraph
from slam.graph.range_bias import RangeBias
from slam.graph.range_bias import estimate_range_bias as estimate_with_graph
from slam.odometry.history import OdometryHistory
from slam.offline.calibration.range_bias import estimate_range_bias
from slam.preprocessing.deskew import deskew


def drive(bias: float, seed: int = 0, seconds: float = 20.0) -> list[object]:
    return list(Simulation("office", seed=seed, duration=seconds, lidar=LidarModel(range_bias=bias)))


@pytest.mark.parametrize("configured", [pytest.param(0.0, marks=pytest.mark.slow), 0.018])
def test_bias_is_found_and_walls_are_as_accurate_as_they_claim(configured: float) -> None:
    """Walls with an unknown bias of 1 cm have a NEES of 20 if the estimate ignores it."""
    config = Config(lidar=LidarConfig(range_bias=configured))
    simulation = Simulation("office", duration=12.0, lidar=LidarModel(range_bias=configured + 0.01))
    nees, finished = measure(simulation, config)
    bias = finished.summary["range_bias"]
    assert 0.0 < bias["sigma"] < 0.002
    assert bias["metres"] == pytest.approx(0.01, abs=4 * bias["sigma"])
    assert np.nanmean(nees.walls) < 2 * 3
    assert np.nanmean(nees.corners) < 2 * 3


class OneBias:
    """A graph whose only unknown is the bias, with a Cauchy kernel far from its optimum: the cost curves downwards."""

    depends_on_bias = True
    optimum, scale, observations = 0.002, 5e-4, 300

    def step(self, values: np.ndarray, bias: float) -> np.ndarray:
        return np.zeros_like(values)

    def retract(self, values: np.ndarray, step: np.ndarray) -> np.ndarray:
        return values + step

    def cost(self, values: np.ndarray, bias: float) -> float:
        return self.observations * float(np.log1p(((bias - self.optimum) / self.scale) ** 2))

    def by_key(self, of_variables: np.ndarray) -> dict[int, np.ndarray]:
        return dict(enumerate(of_variables))


def test_bias_stays_near_its_prior_where_the_cost_is_not_convex() -> None:
    """By the curvature of the prior alone, a step would be metres long."""
    found = estimate_with_graph(cast(ArrayGraph, OneBias()), np.zeros((1, 3)), RangeBias(-0.005, 0.001))
    assert found is not None
    assert abs(found.metres - OneBias.optimum) < 1e-3


def test_map_without_walls_is_an_error() -> None:
    messages = [message for message in drive(0.0, seconds=2.0) if not isinstance(message, Scan)]
    with pytest.raises(MapError):
        estimate_range_bias(messages, Config())


def test_deskewing_subtracts_the_bias() -> None:
    scan = next(message for message in drive(0.02) if isinstance(message, Scan))
    sweep = deskew(scan, OdometryHistory(), np.zeros(3), 0.02)
    np.testing.assert_allclose(sweep.ranges, scan.ranges - 0.02)


@pytest.mark.slow
def test_covariances_are_consistent_with_a_calibrated_lidar() -> None:
    """An unknown bias of 2 cm makes every covariance forty times too small; a calibrated one does not."""
    config, _ = calibrated_config(0.02)
    result = summarise(list(simulate(range(10), range_bias=0.02, config=config)))
    rows = {row.name: row.consistency for row in result.rows}
    assert rows["poses"].consistent
    assert rows["walls"].consistent
    assert rows["corners"].consistent

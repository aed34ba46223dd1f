"""The range bias is estimated from how it bends walls, and subtracted before anything else."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.messages import Scan
from drivers.simulation import LidarModel, Simulation
from features import Extractor, Noise
from slam.config import Config, LidarConfig
from slam.errors import MapError
from slam.evaluation.benchmarks.consistency import calibrated_config, simulate, summarise
from slam.odometry.history import OdometryHistory
from slam.offline.calibration.range_bias import RangeBiasEstimator, estimate_range_bias
from slam.preprocessing.deskew import deskew


def drive(bias: float, seed: int = 0, seconds: float = 20.0) -> list[object]:
    return list(Simulation("office", seed=seed, duration=seconds, lidar=LidarModel(range_bias=bias)))


@pytest.mark.parametrize("bias", [-0.02, 0.0, 0.02, 0.05])
def test_bias_is_found(bias: float) -> None:
    found, sigma = estimate_range_bias(drive(bias), Config())
    assert 0.0 < sigma < 0.002
    assert found == pytest.approx(bias, abs=max(4 * sigma, 0.0015))


def test_estimate_starts_from_the_configured_bias() -> None:
    messages = drive(0.02)
    plain, _ = estimate_range_bias(messages, Config())
    known, _ = estimate_range_bias(messages, Config(lidar=LidarConfig(range_bias=plain)))
    assert known == pytest.approx(plain, abs=5e-4)


def test_one_distant_wall_gives_a_large_standard_error() -> None:
    """A short wall far away is bent by less than the noise."""
    angles = np.linspace(-0.1, 0.1, 60)
    extractor, estimator = Extractor(Noise(0.01, 0.001), adapt_noise=False), RangeBiasEstimator()
    rng = np.random.default_rng(0)
    for _ in range(50):
        ranges = 4.0 / np.cos(angles) + 0.02 + rng.normal(0.0, 0.01, 60)
        estimator.add(ranges, angles, extractor.extract(ranges, angles))
    assert estimator.estimate()[1] > 0.1


def test_too_few_scans_are_an_error() -> None:
    with pytest.raises(MapError, match="0 scans with walls are too few"):
        RangeBiasEstimator().estimate()
    with pytest.raises(MapError, match="too few to calibrate"):
        estimate_range_bias(drive(0.0, seconds=1.0), Config())


def test_deskewing_subtracts_the_bias() -> None:
    scan = next(message for message in drive(0.02) if isinstance(message, Scan))
    sweep = deskew(scan, OdometryHistory(), np.zeros(3), 0.02)
    np.testing.assert_allclose(sweep.ranges, scan.ranges - 0.02)


@pytest.mark.slow
def test_covariances_are_consistent_with_a_calibrated_lidar() -> None:
    """An unknown bias of 2 cm makes every covariance forty times too small; a calibrated one does not."""
    config, _ = calibrated_config(0.02)
    rows = {row.name: row.consistency for row in summarise(list(simulate(range(10), range_bias=0.02, config=config)))}
    assert rows["poses"].consistent
    assert rows["walls"].consistent
    assert rows["corners"].consistent

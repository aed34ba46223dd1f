"""An error that all ranges have in common is found from how it bends walls, and taken off before anything else."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.messages import Scan
from drivers.simulation import LidarModel, Simulation
from features import Extractor, Noise
from slam.config import Config, LidarConfig
from slam.errors import MapError
from slam.evaluation.benchmarks.consistency import calibrated, simulate, summarise
from slam.odometry.history import OdometryHistory
from slam.offline.calibration.range_bias import RangeBias, estimate_range_bias
from slam.preprocessing.deskew import deskew


def drive(bias: float, seed: int = 0, seconds: float = 20.0) -> list[object]:
    return list(Simulation("office", seed=seed, duration=seconds, lidar=LidarModel(range_bias=bias)))


@pytest.mark.parametrize("bias", [-0.02, 0.0, 0.02, 0.05])
def test_the_error_is_found(bias: float) -> None:
    found, sigma = estimate_range_bias(drive(bias), Config())
    assert 0.0 < sigma < 0.002
    assert found == pytest.approx(bias, abs=max(4 * sigma, 0.0015))


def test_what_is_configured_is_where_it_begins() -> None:
    messages = drive(0.02)
    plain, _ = estimate_range_bias(messages, Config())
    known, _ = estimate_range_bias(messages, Config(lidar=LidarConfig(range_bias=plain)))
    assert known == pytest.approx(plain, abs=5e-4)


def test_one_wall_head_on_tells_nothing() -> None:
    """A short wall far away is not bent enough to be seen: the standard error says so."""
    angles = np.linspace(-0.1, 0.1, 60)
    extractor, gathered = Extractor(Noise(0.01, 0.001), adapt_noise=False), RangeBias()
    rng = np.random.default_rng(0)
    for _ in range(50):
        ranges = 4.0 / np.cos(angles) + 0.02 + rng.normal(0.0, 0.01, 60)
        gathered.add(ranges, angles, extractor.extract(ranges, angles))
    assert gathered.estimate()[1] > 0.1


def test_too_few_scans_are_said() -> None:
    with pytest.raises(MapError, match="0 scans with walls are too few"):
        RangeBias().estimate()
    with pytest.raises(MapError, match="too few to calibrate"):
        estimate_range_bias(drive(0.0, seconds=1.0), Config())


def test_known_errors_are_taken_off_standing_and_driving() -> None:
    scan = next(message for message in drive(0.02) if isinstance(message, Scan))
    sweep = deskew(scan, OdometryHistory(), np.zeros(3), 0.02)
    np.testing.assert_allclose(sweep.ranges, scan.ranges - 0.02)


@pytest.mark.slow
def test_covariances_are_honest_with_a_calibrated_lidar() -> None:
    """Two centimetres that nobody knows of make every covariance forty times too small; calibrated they do no harm."""
    config, _ = calibrated(0.02)
    rows = {row.name: row.consistency for row in summarise(list(simulate(range(10), range_bias=0.02, config=config)))}
    assert rows["poses"].consistent
    assert rows["walls"].consistent
    assert rows["corners"].consistent

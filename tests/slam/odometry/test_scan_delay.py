"""The delay of scans against odometry is found where the robot's velocity changes, with its standard deviation."""

import numpy as np
import pytest

from drivers import se2
from slam.config import OdometryConfig
from slam.geometry.segments import Floats
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import OdometryHistory
from slam.odometry.scan_delay import PRIOR_SIGMA, ScanDelay, estimate_scan_delay

DURATION, RATE = 60.0, 50.0
"""Seconds of a drive, and readings of odometry per second."""
INTERVAL = 0.8
"""Seconds between two keyframes."""
REGISTRATION_SIGMAS = np.array([2e-3, 2e-3, 1e-3])
TURN_NOISE = 0.01
"""Radians of random error of odometry per root of a second."""


def drive(delay: float, random: np.random.Generator, *, turning: float = 1.0, every: int = 1) -> ScanDelay:
    """Drive with turns that begin and end, and return the estimate for scans that are stamped late by `delay`.

    turning  factor of the rate of turning
    every    number of the readings of which odometry has one
    """
    times = np.arange(0.0, DURATION, 1.0 / RATE)
    rate = turning * np.sin(0.9 * times) * (np.sin(0.31 * times) > 0.0)
    walk = TURN_NOISE * np.sqrt(1.0 / RATE) * random.standard_normal(len(times))
    true, measured = (integrate(0.4, rates) for rates in (rate, rate + walk * RATE))
    stamps = np.arange(2.0, DURATION - 2.0, INTERVAL)
    path = OdometryHistory.from_arrays(times, true)
    poses = path.at_each(stamps - delay) + REGISTRATION_SIGMAS * random.standard_normal((len(stamps), 3))
    model = OdometryModel(OdometryConfig())
    return estimate_scan_delay(stamps, poses, OdometryHistory.from_arrays(times[::every], measured[::every]), model)


def integrate(speed: float, rates: Floats) -> Floats:
    """Return the poses (n, 3) of a robot at constant speed that turns at `rates` (n,)."""
    headings = np.cumsum(rates) / RATE
    steps = speed / RATE * np.column_stack([np.cos(headings), np.sin(headings)])
    return np.column_stack([np.cumsum(steps, axis=0), se2.wrap(headings)])


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.15, -0.1])
def test_a_delay_is_found(delay: float) -> None:
    found = drive(delay, np.random.default_rng(1))
    assert found.sigma < 0.01
    assert abs(found.seconds - delay) < 3.0 * found.sigma


def test_the_standard_deviation_is_right() -> None:
    drives = [drive(0.05, np.random.default_rng(seed)) for seed in range(60)]
    squares = [((found.seconds - 0.05) / found.sigma) ** 2 for found in drives]
    assert np.mean(squares) == pytest.approx(1.0, abs=0.5)


def test_rare_readings_of_odometry_suffice() -> None:
    found = drive(0.1, np.random.default_rng(3), every=10)  # five a second
    assert found.sigma < 0.02
    assert abs(found.seconds - 0.1) < 3.0 * found.sigma


def test_a_straight_drive_at_constant_speed_says_nothing() -> None:
    found = drive(0.05, np.random.default_rng(2), turning=0.0)
    assert found.sigma > 0.03


def test_a_single_keyframe_says_nothing() -> None:
    history = OdometryHistory.from_arrays(np.array([0.0, 1.0]), np.zeros((2, 3)))
    found = estimate_scan_delay(np.zeros(1), np.zeros((1, 3)), history, OdometryModel(OdometryConfig()))
    assert found == ScanDelay(0.0, PRIOR_SIGMA)

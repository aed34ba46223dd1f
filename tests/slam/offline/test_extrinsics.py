"""Mount and odometry corrections are estimated from a drive as accurately as the standard errors state."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from drivers.messages import Odometry, Scan
from drivers.simulation import LidarModel, Simulation
from slam.config import Config, LidarConfig
from slam.errors import MapError
from slam.geometry.chi_square import chi_square_quantile
from slam.offline.calibration.extrinsics import Calibration, OdometryCorrection, calibrate

ROBOT = LidarModel(beams=180, rate=4.0)
MOUNT = np.array([0.15, -0.05, 0.3])
GUESS = Config(lidar=LidarConfig(mount=(0.1, 0.0, 0.2)))
"""Initial mount, as measured with a ruler and by eye."""


def true_values(simulation: Simulation) -> np.ndarray:
    """Return (6,) the mount, and the factors that undo the simulated errors of the wheels."""
    biases = simulation.biases
    left, right = 1 / biases.left, 1 / biases.right
    mean = (left + right) / 2
    return np.array([*MOUNT, mean, mean * biases.wheelbase, (right - left) / simulation.wheels.wheelbase])


def values(found: Calibration) -> np.ndarray:
    return np.array([*found.mount, found.odometry.length, found.odometry.turning, found.odometry.veer])


def test_mount_and_odometry_correction_are_found_from_a_drive() -> None:
    simulation = Simulation("office", seed=3, duration=25.0, lidar=ROBOT, mount=MOUNT)
    found = calibrate(simulation, GUESS)
    error = values(found) - true_values(simulation)
    assert np.all(np.abs(error) < 4 * found.sigma)
    assert np.all(found.sigma < [0.005, 0.005, 0.003, 0.002, 0.02, 0.02])


@pytest.mark.slow
@pytest.mark.parametrize("heading", [3.1, -1.7])
def test_a_lidar_that_points_backwards_or_aside_is_found(heading: float) -> None:
    mount = np.array([0.15, -0.05, heading])
    simulation = Simulation("office", seed=3, duration=25.0, lidar=ROBOT, mount=mount)
    found = calibrate(simulation, Config(lidar=LidarConfig(mount=(0.0, 0.0, 0.0))))
    error = values(found) - true_values(simulation)
    error[:3] = found.mount - mount
    assert np.all(np.abs(error) < 4 * found.sigma)


@pytest.mark.slow
def test_standard_errors_are_consistent() -> None:
    scaled = []
    for seed in range(10):
        simulation = Simulation("office", seed=seed, duration=90.0, lidar=LidarModel(beams=360), mount=MOUNT)
        found = calibrate(simulation, GUESS)
        scaled.append((values(found) - true_values(simulation)) / found.sigma)
    spread = np.sqrt(np.mean(np.square(scaled), axis=0))
    low, high = (np.sqrt(chi_square_quantile(level, 10) / 10) for level in (0.001, 0.999))
    assert np.all((low < spread) & (spread < high))


def test_correction_undoes_wrong_wheels() -> None:
    steps = np.array([[0.1, 0.0, 0.0], [0.1, 0.01, 0.2], [-0.1, 0.01, -0.2], [0.0, 0.0, 0.3]])
    correction = OdometryCorrection(length=1.02, turning=0.95, veer=0.01)
    poses = np.zeros((5, 3))
    for k, (length, _, turn) in enumerate(steps):
        heading = poses[k, 2]
        chord = length * np.sinc(turn / (2 * np.pi))
        poses[k + 1] = poses[k] + [chord * np.cos(heading + turn / 2), chord * np.sin(heading + turn / 2), turn]
    path = correction.apply(poses)
    assert np.diff(path[:, 2]) == pytest.approx(0.95 * steps[:, 2] + 0.01 * steps[:, 0])
    lengths = np.hypot(*np.diff(path[:, :2], axis=0).T) / np.sinc(np.diff(path[:, 2]) / (2 * np.pi))
    assert lengths == pytest.approx(1.02 * np.abs(steps[:, 0]))
    assert OdometryCorrection().apply(poses) == pytest.approx(poses)


def test_too_little_data_is_an_error() -> None:
    with pytest.raises(MapError, match="too few to calibrate"):
        calibrate([])
    simulation = Simulation("office", duration=3.0, lidar=ROBOT)
    with pytest.raises(MapError, match="too few to calibrate"):
        calibrate([message for message in simulation if isinstance(message, Scan | Odometry)])


@pytest.mark.slow
def test_command_prints_the_corrected_options(wclm: Any) -> None:
    result = wclm("calibrate", "sim:room?duration=25&seed=1&lidar=short", "--wheel-radius", "0.033", "--track", "0.35")
    assert result.exit_code == 0, result.output
    simulation = Simulation("room", seed=1, duration=25.0)
    options = re.search(r"wheel_radius=([\d.]+),([\d.]+)&track=([\d.]+)'$", result.stdout, re.MULTILINE)
    assert options is not None
    left, right, track = (float(text) for text in options.groups())
    assert left == pytest.approx(0.033 / simulation.biases.left, rel=0.01)
    assert right == pytest.approx(0.033 / simulation.biases.right, rel=0.01)
    assert track == pytest.approx(0.35 / simulation.biases.wheelbase, rel=0.03)
    assert "wclm live: --lidar 'TYPE:PORT?mount=0." in result.stdout

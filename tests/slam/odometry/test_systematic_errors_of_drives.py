"""Systematic errors that a simulated drive contains are estimated while it is mapped, within their uncertainty."""

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth
from drivers.simulation import LidarModel, Simulation, WheelModel
from slam.config import Config, LidarConfig
from slam.pipeline import Slam

MOUNT = np.array([0.1, 0.0, 0.0])
LIDAR = LidarModel(beams=180, rate=3.0)
ERROR = np.array([0.07, -0.04, 0.03])
"""Of the mount in the settings, in the base's frame."""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_wheels_too_long_and_a_wrong_mount_are_found(seed: int) -> None:
    """Drive with wheels that measure 3 % too long, and with a lidar that is 7 cm and 2 degrees from where it seems."""
    wheels = WheelModel(scale_bias=0.03, difference_bias=0.0, wheelbase_bias=0.0)
    simulation = Simulation("office", seed=seed, duration=90.0, lidar=LIDAR, wheels=wheels, mount=MOUNT)
    stated = se2.compose(ERROR, MOUNT)
    slam = Slam(Config(lidar=LidarConfig(mount=tuple(stated.tolist()))))
    for message in simulation:
        if not isinstance(message, GroundTruth):
            slam.add(message)
    slam.finish()
    errors = slam.slam_state.odometry_model.systematic_errors
    # The axle is where the true mount puts the base; the base of the map is where the stated mount puts it.
    axle = se2.compose(stated, se2.inverse(MOUNT))
    mean = 0.5 * (1.0 / simulation.biases.left + 1.0 / simulation.biases.right)
    difference = errors.values - [mean, mean, 0.0, *axle]
    difference[5] = se2.wrap(difference[5])
    assert np.all(np.abs(difference) < 3.0 * np.sqrt(errors.variances)), (difference, np.sqrt(errors.variances))
    assert np.all(np.sqrt(errors.variances) < [0.01, 0.02, 0.01, 0.01, 0.01, 0.01])

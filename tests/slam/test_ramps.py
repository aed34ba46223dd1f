"""A robot that drives over ramps: its lidar tilts, and sees the floor as a straight line ahead."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Message, Scan
from drivers.simulation import LidarModel, Simulation, load_world
from slam.config import Config
from slam.pipeline import Slam

LIDAR = LidarModel(beams=500, rate=8.0, range_max=12.0, sigma_range=0.01)
DURATION = 40.0
PERIOD, LENGTH = 12.0, 4.0  # seconds from ramp to ramp, and on a ramp
NEAREST = 1.5  # metres to the floor where the lidar is tilted most


def over_ramps(drive: Simulation, seed: int) -> Iterator[Message]:
    """Yield the messages of a drive with scans that end on the floor while the robot is on a ramp.

    A lidar at the height h whose pitch is p sees the floor at h / tan p ahead, on a line across. The pitch is half a
    period of a sine.
    """
    noise = np.random.default_rng(seed)
    for message in drive:
        since_ramp = math.fmod(message.stamp, PERIOD) - (PERIOD - LENGTH)
        if isinstance(message, Scan) and since_ramp > 0.0:
            ahead = NEAREST / math.sin(math.pi * since_ramp / LENGTH)
            cosines = np.cos(message.angles)
            floor = np.where(cosines > 0.1, ahead / np.maximum(cosines, 0.1), np.inf)
            floor = floor + LIDAR.sigma_range * noise.standard_normal(len(floor))
            ranges = np.fmin(np.where(np.isnan(message.ranges), np.inf, message.ranges), floor)
            message = replace(message, ranges=np.where(ranges < LIDAR.range_max, ranges, np.nan))
        yield message


@pytest.mark.slow
@pytest.mark.parametrize(("world", "seed"), [("museum", 1), ("museum", 2)])
def test_the_floor_ahead_does_not_move_the_robot(world: str, seed: int) -> None:
    drive, slam = Simulation(load_world(world), seed, DURATION, LIDAR), Slam(Config())
    for message in over_ramps(drive, seed):
        slam.add(message)
    finished = slam.finish()
    true = drive.trajectory.poses_at(finished.stamps)
    found = se2.compose(true[0], se2.between(finished.poses[0], finished.poses))
    errors = np.hypot(*(found - true)[:, :2].T)
    assert np.sqrt(np.mean(errors**2)) < 0.1

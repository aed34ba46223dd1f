"""A robot is localised in its map although its wheels measure otherwise than when it mapped."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry
from drivers.simulation import LidarModel, Simulation, WheelModel
from slam import Slam
from slam.evaluation.benchmarks.scenarios.buildings import random_building
from slam.events import Finished

BUILDING = random_building(1295)
DURATION, LATER = 75.0, 1000.0  # seconds of each drive, and from one to the other
LIDAR = LidarModel(beams=180, rate=5.0, field_of_view=np.pi, range_max=6.0)
WHEELS = WheelModel(scale_bias=0.0, difference_bias=0.0, wheelbase_bias=0.0)
LENGTHS = 1.06  # of a motion by odometry on the second day, relative to the first


def drive(seed: int, shift: float, lengths: float) -> list[Message]:
    """Return a drive along the same path, in which odometry has the given scale of lengths."""
    simulation = Simulation(BUILDING, seed=seed, duration=DURATION, lidar=LIDAR, wheels=WHEELS)
    return [
        replace(m, stamp=m.stamp + shift, pose=m.pose * np.array([lengths, lengths, 1.0]))
        if isinstance(m, Odometry)
        else replace(m, stamp=m.stamp + shift)
        for m in simulation
    ]


def add_all(slam: Slam, messages: Iterable[Message]) -> Finished:
    for message in messages:
        if not isinstance(message, GroundTruth):
            slam.add(message)
    return slam.finish()


@pytest.mark.parametrize("lengths", [LENGTHS, 1.0 / LENGTHS])
def test_other_wheels_do_not_move_the_robot_along_a_corridor_of_a_known_map(lengths: float) -> None:
    mapping = Slam()
    add_all(mapping, drive(1, 0.0, 1.0))
    localising, messages = Slam(resumed=mapping.session, frozen=True, start=np.zeros(3)), drive(2, LATER, lengths)
    finished = add_all(localising, messages)
    truth = [message for message in messages if isinstance(message, GroundTruth)]
    stamps, true = np.array([m.stamp for m in truth]), np.array([m.pose for m in truth])
    rows = np.minimum(np.searchsorted(stamps, finished.stamps), len(stamps) - 1)
    errors = np.hypot(*(finished.poses - se2.between(true[0], true[rows]))[:, :2].T)
    assert errors.max() < 0.2
    assert localising.slam_state.odometry_model.systematic_errors.length == pytest.approx(1.0 / lengths, abs=0.02)

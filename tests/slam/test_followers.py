"""People who walk with the robot: most of what it sees moves as it does."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from drivers.simulation import LidarModel, Simulation, load_world
from slam.config import Config
from slam.evaluation.benchmarks.scenarios.world_variants import add_crowd
from slam.pipeline import Slam

LIDAR = LidarModel(beams=500, rate=5.4, field_of_view=float(np.radians(270.0)), range_max=7.0, sigma_range=0.02)
"""One that hardly sees more of a corridor than its walls."""
DURATION = 20.0


@pytest.mark.parametrize("seed", [*(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2)), 3])
def test_people_who_walk_along_a_corridor_with_the_robot_do_not_hold_it_back(seed: int) -> None:
    world = add_crowd(load_world("corridor"), 4, np.random.default_rng(seed), DURATION)
    drive, slam = Simulation(world, seed, DURATION, LIDAR), Slam(Config())
    for message in drive:
        slam.add(message)
    finished = slam.finish()
    true = drive.trajectory.poses_at(finished.stamps)
    driven, found = (se2.between(poses[0], poses[-1]) for poses in (true, finished.poses))
    length = float(np.hypot(driven[0], driven[1]))
    # Nothing but odometry shows the way along the corridor; its wheels are 2 % too large or too small (1 sigma).
    assert np.hypot(*(found - driven)[:2]) < 0.06 * length
    assert abs(se2.wrap(found[2] - driven[2])) < np.radians(1.0)

"""Covariances of the mapper's keyframes."""

import numpy as np
import pytest

import drivers
from slam import Slam


@pytest.mark.slow
@pytest.mark.parametrize("world", ["office", "large_loop"])
def test_bound_of_a_relative_covariance_is_no_smaller_than_that(world: str) -> None:
    slam = Slam()
    for message in drivers.open(f"sim:{world}?odometry=bad&lidar=short&duration=25&seed=3"):
        slam.add(message)
    mapper = slam.slam_state.mapper
    mapper.solve_waiting()
    last = mapper.keyframe_count - 1
    for old in range(0, last, max(1, last // 6)):
        exact = mapper.covariances.relative(old, last)
        surplus = mapper.covariances.relative_bound(old, last) - exact
        assert np.linalg.eigvalsh(surplus)[0] > -1e-9

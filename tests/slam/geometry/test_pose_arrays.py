"""Arrays of poses in compiled code, compared with `drivers.se2`."""

import numpy as np
import pytest

from drivers import se2
from slam.geometry.pose_arrays import between_each, compose_each, unwrapped


@pytest.mark.parametrize(("first", "second"), [(7, 7), (1, 7), (7, 1), (1, 1)])
def test_products_and_relative_poses_are_those_of_single_poses(first: int, second: int) -> None:
    random = np.random.default_rng(1)
    one, other = (random.uniform([-9.0, -9.0, -4.0], [9.0, 9.0, 4.0], (count, 3)) for count in (first, second))
    count = max(first, second)
    pairs = list(zip(np.broadcast_to(one, (count, 3)), np.broadcast_to(other, (count, 3)), strict=True))
    np.testing.assert_array_equal(compose_each(one, other), [se2.compose(*pair) for pair in pairs])
    np.testing.assert_array_equal(between_each(one, other), [se2.between(*pair) for pair in pairs])


def test_angles_are_unwrapped_as_by_numpy() -> None:
    random = np.random.default_rng(2)
    for spread in (0.1, 3.0, 9.0):
        angles = se2.wrap(np.cumsum(random.uniform(-spread, spread, 200)))
        np.testing.assert_array_equal(unwrapped(angles), np.unwrap(angles))
    turned = np.array([0.0, np.pi, 0.0, -np.pi, np.pi])
    np.testing.assert_array_equal(unwrapped(turned), np.unwrap(turned))
    assert not len(unwrapped(np.zeros(0)))

"""Parts of a map are connected only after they were joined; odometry makes them reachable."""

from __future__ import annotations

import numpy as np

from slam.mapping.map_parts import MapParts

KEYFRAMES = np.arange(30)


def three_parts() -> MapParts:
    """Return parts that begin at the keyframes 0, 10 and 20; odometry leads to the second one only."""
    parts = MapParts()
    parts.begin(10, measured=True)
    parts.begin(20, measured=False)
    return parts


def test_one_part_is_connected() -> None:
    parts = MapParts()
    assert parts.connected(KEYFRAMES).all()
    assert parts.reachable(KEYFRAMES).all()
    assert not parts.current_is_apart


def test_parts_are_not_connected_before_they_are_joined() -> None:
    parts = three_parts()
    np.testing.assert_array_equal(parts.connected(KEYFRAMES), KEYFRAMES >= 20)
    np.testing.assert_array_equal(parts.connected(KEYFRAMES, 5), KEYFRAMES < 10)
    assert parts.apart == [1, 2]
    parts.join(5, 25)
    np.testing.assert_array_equal(parts.connected(KEYFRAMES), (KEYFRAMES < 10) | (KEYFRAMES >= 20))
    assert (parts.current_first, parts.last_run_first) == (0, 20)
    assert parts.apart == [1]
    assert not parts.current_is_apart


def test_joins_are_transitive() -> None:
    parts = three_parts()
    parts.join(25, 15)
    assert parts.current_is_apart
    assert (parts.current_first, parts.last_run_first) == (10, 10)
    parts.join(12, 3)
    assert parts.connected(KEYFRAMES).all()
    assert parts.last_run_first == 0


def test_motions_that_odometry_measured_and_joins_make_parts_reachable() -> None:
    parts = three_parts()
    np.testing.assert_array_equal(parts.reachable(KEYFRAMES), KEYFRAMES >= 20)
    parts.join(25, 15)
    assert parts.reachable(KEYFRAMES).all()


def test_a_part_without_keyframes_is_replaced() -> None:
    parts = three_parts()
    parts.begin(20, measured=True)
    assert parts.firsts == [0, 10, 20]
    assert not parts.measured[-1]  # the robot may have been carried all the same


def test_maps_that_follow_each_other_are_joined() -> None:
    assert MapParts().followed_by(MapParts(), 10).firsts == [0]
    both = three_parts().followed_by(three_parts(), 30)
    assert both.firsts == [0, 10, 20, 30, 40, 50]
    assert both.groups == [0, 1, 2, 0, 4, 5]


def test_the_largest_group_is_that_with_most_keyframes() -> None:
    parts = MapParts([0, 10, 15], [0, 1, 2])
    assert not parts.current_is_largest(25)  # as large as the first part
    assert parts.current_is_largest(26)
    assert not MapParts([0, 10, 15], [0, 0, 2]).current_is_largest(26)
    assert MapParts([0, 10, 15], [0, 1, 1]).current_is_largest(21)

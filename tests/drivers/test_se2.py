"""Transforms in the plane: single poses and stacks, and what they are inverse to."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2

RANDOM = np.random.default_rng(0)
FIRST = np.column_stack([RANDOM.uniform(-50, 50, (40, 2)), RANDOM.uniform(-7, 7, 40)])
SECOND = np.column_stack([RANDOM.uniform(-50, 50, (40, 2)), RANDOM.uniform(-7, 7, 40)])


@pytest.mark.parametrize("function", [se2.compose, se2.between])
def test_single_poses_and_stacks_give_the_same(function: object) -> None:
    assert callable(function)
    single = np.array([function(a, b) for a, b in zip(FIRST, SECOND, strict=True)])
    np.testing.assert_allclose(single, function(FIRST, SECOND), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(single[:, None], function(FIRST[:, None], SECOND[:, None]), rtol=1e-12, atol=1e-12)


def test_between_is_inverse_to_compose() -> None:
    for a, b in zip(FIRST, SECOND, strict=True):
        error = se2.compose(a, se2.between(a, b)) - b
        error[2] = se2.wrap(error[2])
        np.testing.assert_allclose(error, 0.0, atol=1e-12)
        np.testing.assert_allclose(se2.compose(a, se2.inverse(a)), 0.0, atol=1e-12)
        assert -np.pi <= se2.compose(a, b)[2] < np.pi


def test_a_single_pose_and_a_stack_broadcast() -> None:
    np.testing.assert_allclose(se2.compose(FIRST[0], SECOND)[3], se2.compose(FIRST[0], SECOND[3]), atol=1e-12)
    np.testing.assert_allclose(se2.between(FIRST, SECOND[0])[3], se2.between(FIRST[3], SECOND[0]), atol=1e-12)


def test_exp_is_inverse_to_log() -> None:
    poses = np.vstack([se2.compose(FIRST, np.zeros(3)), [1.0, 2.0, 0.0], [1.0, 2.0, 1e-12]])
    np.testing.assert_allclose(se2.exp(se2.log(poses)), poses, atol=1e-9)
    np.testing.assert_allclose(se2.exp(se2.log(poses[3])), poses[3], atol=1e-9)


def test_log_is_the_twist_that_is_constant_along_the_way() -> None:
    tenth = se2.exp(0.1 * se2.log(FIRST))
    moved = np.zeros_like(FIRST)
    for _ in range(10):
        moved = se2.compose(moved, tenth)
    np.testing.assert_allclose(moved, se2.compose(FIRST, np.zeros(3)), atol=1e-9)


def test_errors_of_a_heading_are_twists_in_proportion() -> None:
    """A heading error at one place turns all that was driven since around this place."""
    since = np.array([10.0, 3.0, 1.0])
    errors = [se2.log(se2.between(since, se2.compose([0.0, 0.0, turn], since))) / turn for turn in (0.001, 0.8)]
    np.testing.assert_allclose(errors[0], errors[1], rtol=1e-6)

"""Poses in compiled code: the same as with `drivers.se2`."""

from __future__ import annotations

import numpy as np

from drivers import se2
from slam.geometry.pose_steps import move_back, pose_error, wrap_heading

RNG = np.random.default_rng(1)
POSES = RNG.uniform(-9.0, 9.0, (1000, 3))


def test_headings_are_wrapped_as_elsewhere_to_the_last_digit() -> None:
    for pose in POSES:
        expected = float(se2.wrap(pose[2]))
        wrap_heading(pose)
        assert pose[2] == expected


def test_a_pose_moves_back_against_a_step_along_its_own_axes() -> None:
    for pose in POSES[:20]:
        step, moved = RNG.normal(size=3), pose.copy()
        move_back(moved, step)
        assert np.allclose(moved[:2], se2.compose(pose, -step)[:2])
        assert moved[2] == pose[2] - step[2]


def test_the_error_of_a_pose_is_in_its_own_axes() -> None:
    for pose, prediction in zip(POSES[:20], POSES[20:40], strict=True):
        error = pose_error(prediction, pose)
        assert np.allclose(error[:2], -se2.between(pose, prediction)[:2])
        assert np.isclose(error[2], se2.wrap(pose[2] - prediction[2]))

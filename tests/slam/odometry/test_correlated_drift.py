"""Correlated drift: along a bare corridor the map stays connected, and its covariances cover the error of odometry."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import se2
from drivers.messages import GroundTruth
from drivers.simulation import LIDAR_MODELS, Simulation
from slam import Slam
from slam.config import Config
from slam.odometry.correlated_drift import embed_position_covariance, rotate_covariance

LENGTH = 60.0  # metres
BEND = 0.01  # metres: standard deviation of the walls' positions, every 3 m


def bent_corridor(folder: Path, seed: int) -> Path:
    """Write a world of a corridor with slightly bent walls and a pillar every 17 m."""
    random = np.random.default_rng(seed)
    walls = [f"{{ from = [{x}, -1.2], to = [{x}, 1.2] }}" for x in (-2.0, LENGTH + 1.0)]
    walls += [f"{{ from = [{x}, 0.95], to = [{x}, 1.2] }}" for x in np.arange(12.0, LENGTH, 17.0)]
    for y in (-1.2, 1.2):
        along = np.arange(-2.0, LENGTH + 2.1, 3.0)
        points = np.column_stack([along, y + random.normal(0, BEND, len(along))]).round(4).tolist()
        walls += [f"{{ from = {begin}, to = {end} }}" for begin, end in pairwise(points)]
    world = folder / "corridor.toml"
    path = [[0, 0], [LENGTH / 2, 0.2], [LENGTH - 1, 0]]
    world.write_text(f"speed = 0.8\npath = {path}\nwalls = [\n" + ",\n".join(walls) + "\n]\n")
    return world


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 5])
def test_slightly_bent_walls_do_not_tear_a_corridor_apart(tmp_path: Path, seed: int) -> None:
    simulation = Simulation(bent_corridor(tmp_path, seed), seed=seed, lidar=replace(LIDAR_MODELS["short"], rate=4.0))
    slam, truth = Slam(), []
    for message in simulation:
        if isinstance(message, GroundTruth):
            truth.append(message.pose)
        slam.add(message)
    finished = slam.finish()
    assert (
        np.hypot(*np.diff(finished.keyframes.poses[:, :2], axis=0).T).max() < 1.25 * Config().mapping.keyframe_distance
    )
    error = se2.between(se2.between(truth[0], truth[-1]), finished.poses[-1])
    assert abs(error[0]) < 0.02 * LENGTH  # the wheels' error
    sigma = np.sqrt(slam.keyframe_covariance(len(finished.keyframes) - 1)[0, 0])
    assert 0.3 * abs(error[0]) < sigma < 5.0
    across = np.sqrt(slam.keyframe_covariance(len(finished.keyframes) - 1)[1, 1])
    assert across < 0.2 * sigma


numbers = st.floats(-2.0, 2.0)


@given(root=st.tuples(numbers, numbers, numbers), angle=st.floats(-10.0, 10.0))
def test_a_covariance_is_rotated_with_its_axes(root: tuple[float, float, float], angle: float) -> None:
    factor = np.array([[root[0], 0.0], [root[1], root[2]]])
    covariance = embed_position_covariance(factor @ factor.T)
    np.testing.assert_allclose(covariance[:2, :2], factor @ factor.T, atol=1e-9)
    assert not covariance[2].any()
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])  # the first axis, rotated
    assert axis @ rotate_covariance(covariance, angle) @ axis == pytest.approx(covariance[0, 0], abs=1e-9)
    np.testing.assert_allclose(rotate_covariance(rotate_covariance(covariance, angle), -angle), covariance, atol=1e-9)


def test_negative_eigenvalues_are_clamped_to_zero() -> None:
    np.testing.assert_allclose(embed_position_covariance(np.diag([1.0, -0.5])), np.diag([1.0, 0.0, 0.0]), atol=1e-12)

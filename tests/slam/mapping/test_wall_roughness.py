"""Wall roughness: estimated from residuals, and added to covariances."""

from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import Segments
from slam.mapping.local_map import LocalMap, empty_local_map
from slam.mapping.wall_roughness import WallRoughness, add_roughness


def residuals_about_walls(roughness: float, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals of segments on walls of a roughness (metres), their covariances and half lengths."""
    random = np.random.default_rng(seed)
    sigma = random.uniform(0.001, 0.003, (count, 2))
    halves = random.uniform(0.3, 2.0, count)
    covariances = sigma[:, :, None] ** 2 * np.eye(2)
    whole = add_roughness(covariances, halves, roughness**2)
    residuals = np.sqrt(np.diagonal(whole, axis1=1, axis2=2)) * random.normal(size=(count, 2))
    return residuals, covariances, halves


@pytest.mark.parametrize("roughness", [0.004, 0.01])
def test_roughness_is_learned_despite_wrong_associations(roughness: float) -> None:
    estimate = WallRoughness()
    for seed in range(40):
        residuals, covariances, halves = residuals_about_walls(roughness, 12, seed)
        residuals[0] += 0.1
        estimate.add_residuals(residuals, covariances, halves)
    assert np.sqrt(estimate.variance) == pytest.approx(roughness, rel=0.25)


def test_perfect_walls_have_no_roughness() -> None:
    estimate = WallRoughness()
    assert estimate.variance > 0.0
    for seed in range(60):
        estimate.add_residuals(*residuals_about_walls(0.0, 12, seed))
    assert np.sqrt(estimate.variance) < 5e-4


def test_roughness_affects_the_heading_of_short_segments_more() -> None:
    result = add_roughness(np.zeros((2, 2, 2)), np.array([0.5, 1.0]), 1e-6)
    np.testing.assert_allclose(result[:, 0, 0], 1e-6)
    np.testing.assert_allclose(result[:, 1, 1], [1.2e-5, 3e-6])  # 12 f / length squared


def walls_around(count: int) -> LocalMap:
    """Return a local map of well-observed walls in all directions, known to a millimetre and a milliradian."""
    directions = np.linspace(-np.pi, np.pi, count, endpoint=False)
    frame = np.column_stack([3.0 * np.cos(directions), 3.0 * np.sin(directions), directions + np.pi / 2])
    covariance = np.tile(1e-6 * np.eye(2), (count, 1, 1))
    return replace(
        empty_local_map(), walls=np.arange(count), frame=frame, wall_covariance=covariance,
        observations=np.full(count, 100),
    )  # fmt: skip


@pytest.mark.parametrize("roughness", [0.0, 0.01])
def test_errors_of_poses_and_walls_are_not_roughness(roughness: float) -> None:
    """Monte Carlo: segments of walls, their landmarks and the poses of scans have the errors that are stated."""
    random, estimate, local_map = np.random.default_rng(0), WallRoughness(), walls_around(12)
    halves, sigmas = np.full(12, 0.8), np.array([0.01, 0.01, 0.005])
    covariance = np.tile(4e-6 * np.eye(2), (12, 1, 1))
    own = np.sqrt(np.diagonal(add_roughness(covariance, halves, roughness**2), axis1=1, axis2=2))
    for _ in range(80):
        pose = np.array([*random.uniform(-1.0, 1.0, 2), random.uniform(-3.0, 3.0)])
        errors = np.zeros((12, 3))
        errors[:, 1:] = own * random.normal(size=(12, 2)) - 1e-3 * random.normal(size=(12, 2))
        frames = se2.between(pose, se2.compose(local_map.frame, errors))
        found = se2.compose(pose, sigmas * random.normal(size=3))
        estimate.add_scan(found, np.diag(sigmas**2), Segments(frames, halves, covariance), local_map, np.arange(12))
    assert np.sqrt(estimate.variance) == pytest.approx(roughness, rel=0.3, abs=2e-3)

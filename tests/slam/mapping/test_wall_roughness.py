"""Wall roughness: estimated from residuals, and added to covariances."""

import numpy as np
import pytest

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

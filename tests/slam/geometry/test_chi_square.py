import numpy as np
import pytest
from scipy.special import chdtrc, chdtri

from slam.geometry.chi_square import chi_square_quantile, chi_square_tail


@pytest.mark.parametrize("dof", range(1, 8))
def test_the_tail_is_that_of_the_distribution(dof: int) -> None:
    squared = np.concatenate([[0.0], np.logspace(-6, 2.5, 200)])
    np.testing.assert_allclose(chi_square_tail(dof, squared), chdtrc(dof, squared), rtol=1e-12)


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_nothing_is_larger_than_infinity(dof: int) -> None:
    np.testing.assert_allclose(chi_square_tail(dof, np.array([1e6, np.inf])), 0.0, atol=1e-300)


@pytest.mark.parametrize(
    ("dof", "tolerance"), [(1, 1e-9), (2, 1e-9), (3, 1e-9), (100, 1e-9), (101, 5e-4), (3000, 5e-4)]
)
@pytest.mark.parametrize("probability", [0.01, 0.025, 0.5, 0.975, 0.99])
def test_quantiles_agree_with_scipy(dof: int, tolerance: float, probability: float) -> None:
    assert chi_square_quantile(probability, dof) == pytest.approx(chdtri(dof, 1.0 - probability), rel=tolerance)


@pytest.mark.parametrize("probability", [1e-6, 0.001, 0.999, 1.0 - 1e-6])
def test_small_probabilities_of_few_degrees_are_exact(probability: float) -> None:
    assert chi_square_quantile(probability, 3) == pytest.approx(chdtri(3, 1.0 - probability), rel=1e-9)

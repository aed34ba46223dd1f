import numpy as np
import pytest
from scipy.special import chdtrc, chdtri

from slam.graph.chi_square import chi_square_quantile, chi_square_tail


@pytest.mark.parametrize("dof", range(1, 8))
def test_the_tail_is_that_of_the_distribution(dof: int) -> None:
    squared = np.concatenate([[0.0], np.logspace(-6, 2.5, 200)])
    np.testing.assert_allclose(chi_square_tail(dof, squared), chdtrc(dof, squared), rtol=1e-12)


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_nothing_is_larger_than_infinity(dof: int) -> None:
    np.testing.assert_allclose(chi_square_tail(dof, np.array([1e6, np.inf])), 0.0, atol=1e-300)


@pytest.mark.parametrize(("degrees", "tolerance"), [(10, 0.01), (30, 0.001), (300, 0.0001)])
@pytest.mark.parametrize("probability", [0.025, 0.5, 0.975])
def test_quantiles_agree_with_scipy(degrees: int, tolerance: float, probability: float) -> None:
    assert chi_square_quantile(probability, degrees) == pytest.approx(chdtri(degrees, 1.0 - probability), rel=tolerance)

import numpy as np
import pytest
from scipy.special import chdtrc

from slam.graph.chi_square import chi_square_tail


@pytest.mark.parametrize("dof", range(1, 8))
def test_the_tail_is_that_of_the_distribution(dof: int) -> None:
    squared = np.concatenate([[0.0], np.logspace(-6, 2.5, 200)])
    np.testing.assert_allclose(chi_square_tail(dof, squared), chdtrc(dof, squared), rtol=1e-12)


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_nothing_is_larger_than_infinity(dof: int) -> None:
    np.testing.assert_allclose(chi_square_tail(dof, np.array([1e6, np.inf])), 0.0, atol=1e-300)

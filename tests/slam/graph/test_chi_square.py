"""Tail and quantiles of the chi-square distribution."""

import numpy as np
import pytest
from scipy.special import chdtrc, chdtri

from slam.graph.chi_square import chi_square_gate, chi_square_tail


@pytest.mark.parametrize("dof", range(1, 8))
def test_the_tail_is_that_of_scipy(dof: int) -> None:
    squared = [0.0, 1e-12, 0.1, 1.0, 10.8, 100.0, 1e4, np.inf]
    np.testing.assert_allclose([chi_square_tail(x, dof) for x in squared], chdtrc(dof, squared), rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("dof", range(1, 8))
@pytest.mark.parametrize("probability", [0.001, 0.05, 0.5, 0.99])
def test_the_gate_is_that_of_scipy(dof: int, probability: float) -> None:
    assert chi_square_gate(probability, dof) == pytest.approx(chdtri(dof, probability), rel=1e-9)

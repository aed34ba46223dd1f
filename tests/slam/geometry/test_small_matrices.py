"""Symmetric positive definite matrices (3, 3) in compiled code, compared with NumPy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.geometry.small_matrices import inverse, log_determinant, solve


@settings(deadline=None)  # the first call may compile
@given(seed=st.integers(0, 2**32 - 1), exponents=st.tuples(*[st.floats(-4.0, 6.0)] * 3))
def test_results_are_those_of_numpy(seed: int, exponents: tuple[float, float, float]) -> None:
    random = np.random.default_rng(seed)
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    scale = 10.0 ** np.array(exponents)
    matrix, vector = axes @ np.diag(scale) @ axes.T, random.normal(size=3)
    matrix = 0.5 * (matrix + matrix.T)
    condition = scale.max() / scale.min()
    assert np.abs(matrix @ inverse(matrix) - np.eye(3)).max() < 1e-14 * condition + 1e-12
    assert np.abs(matrix @ solve(matrix, vector) - vector).max() < 1e-14 * condition + 1e-12
    assert abs(log_determinant(matrix) - np.log(scale).sum()) < 1e-14 * condition + 1e-12


def test_matrix_that_is_not_positive_definite_gives_nan() -> None:
    matrix = np.diag([1.0, -1.0, 1.0])
    assert np.isnan(inverse(matrix)).any()
    assert np.isnan(solve(matrix, np.ones(3))).any()
    assert np.isnan(log_determinant(matrix))

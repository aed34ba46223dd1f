"""Small symmetric matrices in compiled code, compared with NumPy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.small_matrices import (
    bilinear_form,
    inverse,
    log_determinant,
    mahalanobis_squared,
    product,
    quadratic_form,
    solve,
    without_negative_part,
)

SEEDS = st.integers(0, 2**32 - 1)
EXPONENTS = st.tuples(*[st.floats(-4.0, 6.0)] * 3)


@settings(deadline=None)  # the first call may compile
@given(seed=SEEDS, exponents=EXPONENTS)
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


@settings(deadline=None)
@given(seed=SEEDS)
def test_products_are_those_of_numpy(seed: int) -> None:
    random = np.random.default_rng(seed)
    matrix, u, v = random.normal(size=(3, 3)), random.normal(size=3), random.normal(size=3)
    matrix = matrix + matrix.T
    assert np.abs(product(matrix, v) - matrix @ v).max() < 1e-13
    assert abs(quadratic_form(matrix, *v) - v @ matrix @ v) < 1e-12
    assert abs(bilinear_form(matrix, *u, *v) - u @ matrix @ v) < 1e-12
    root = random.normal(size=(2, 2))
    covariance = root @ root.T + 0.1 * np.eye(2)
    found = mahalanobis_squared(covariance[0, 0], covariance[0, 1], covariance[1, 1], *v[:2])
    assert abs(found - v[:2] @ np.linalg.solve(covariance, v[:2])) < 1e-10 * (1.0 + found)


@settings(deadline=None)
@given(seed=SEEDS, exponents=EXPONENTS, signs=st.tuples(*[st.sampled_from([-1.0, 0.0, 1.0])] * 3))
def test_negative_eigenvalues_become_zero(
    seed: int, exponents: tuple[float, float, float], signs: tuple[float, float, float]
) -> None:
    axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    eigenvalues = np.array(signs) * 10.0 ** np.array(exponents)
    matrix = (axes * eigenvalues) @ axes.T
    expected = (axes * np.maximum(eigenvalues, 0.0)) @ axes.T
    found = without_negative_part(0.5 * (matrix + matrix.T))
    assert np.abs(found - expected).max() <= 1e-13 * np.abs(eigenvalues).max()


def test_diagonal_and_zero_matrices_keep_their_positive_part() -> None:
    assert np.array_equal(without_negative_part(np.diag([2.0, -1.0, 0.0])), np.diag([2.0, 0.0, 0.0]))
    assert np.array_equal(without_negative_part(np.zeros((3, 3))), np.zeros((3, 3)))


def test_matrix_that_is_not_positive_definite_gives_nan() -> None:
    matrix = np.diag([1.0, -1.0, 1.0])
    assert np.isnan(inverse(matrix)).any()
    assert np.isnan(solve(matrix, np.ones(3))).any()
    assert np.isnan(log_determinant(matrix))

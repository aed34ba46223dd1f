"""Small symmetric matrices in compiled code, those of size (3, 3) by Cholesky's decomposition M = L L'.

NumPy takes some microseconds for each call, which adds up at several calls for each scan. BLAS and LAPACK, which numba
calls for products and decompositions of arrays, would have to be loaded with SciPy. If a matrix is not positive
definite where it has to be, results are NaN, or ZeroDivisionError is raised.
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled, inlined

# Sweeps of Jacobi's method; it converges quadratically. Origin: numerical, 20 000 random matrices took four at most.
MAX_SWEEPS = 10
# Share of the largest element: smaller elements off the diagonal are rounding errors. Origin: numerical.
NEGLIGIBLE = 1e-16


@inlined
def _cholesky(matrix):  # type: ignore[no-untyped-def]
    """Return the elements of L, row by row."""
    l00 = math.sqrt(matrix[0, 0])
    l10, l20 = matrix[1, 0] / l00, matrix[2, 0] / l00
    l11 = math.sqrt(matrix[1, 1] - l10 * l10)
    l21 = (matrix[2, 1] - l20 * l10) / l11
    return l00, l10, l11, l20, l21, math.sqrt(matrix[2, 2] - l20 * l20 - l21 * l21)


@compiled
def solve(matrix, vector):  # type: ignore[no-untyped-def]
    """Return x (3,) of M x = v."""
    return np.array(solution(matrix, vector))


@inlined
def solution(matrix, vector):  # type: ignore[no-untyped-def]
    """Return the three elements of x of M x = v."""
    l00, l10, l11, l20, l21, l22 = _cholesky(matrix)
    y0 = vector[0] / l00
    y1 = (vector[1] - l10 * y0) / l11
    y2 = (vector[2] - l20 * y0 - l21 * y1) / l22
    x2 = y2 / l22
    x1 = (y1 - l21 * x2) / l11
    return (y0 - l10 * x1 - l20 * x2) / l00, x1, x2


@compiled
def inverse(matrix):  # type: ignore[no-untyped-def]
    """Return the inverse (3, 3) of a matrix."""
    l00, l10, l11, l20, l21, l22 = _cholesky(matrix)
    i00, i11, i22 = 1.0 / l00, 1.0 / l11, 1.0 / l22  # the inverse of L
    i10, i21 = -l10 * i00 * i11, -l21 * i11 * i22
    i20 = -(l20 * i00 + l21 * i10) * i22
    result = np.empty((3, 3))
    result[0, 0], result[1, 1], result[2, 2] = i00 * i00 + i10 * i10 + i20 * i20, i11 * i11 + i21 * i21, i22 * i22
    result[0, 1] = result[1, 0] = i10 * i11 + i20 * i21
    result[0, 2] = result[2, 0] = i20 * i22
    result[1, 2] = result[2, 1] = i21 * i22
    return result


@compiled
def log_determinant(matrix):  # type: ignore[no-untyped-def]
    """Return the logarithm of the determinant."""
    l00, _, l11, _, _, l22 = _cholesky(matrix)
    return 2.0 * math.log(l00 * l11 * l22)


@inlined
def is_positive_definite(matrix):  # type: ignore[no-untyped-def]
    """Return True if a symmetric matrix (3, 3) is positive definite."""
    a, b, c = matrix[0, 0], matrix[1, 0], matrix[2, 0]
    if not a > 0.0:
        return False
    d, e, f = matrix[1, 1] - b * b / a, matrix[2, 1] - b * c / a, matrix[2, 2] - c * c / a
    return d > 0.0 and f - e * e / d > 0.0


@inlined
def product(matrix, vector):  # type: ignore[no-untyped-def]
    """Return the three elements of M v."""
    return (
        matrix[0, 0] * vector[0] + matrix[0, 1] * vector[1] + matrix[0, 2] * vector[2],
        matrix[1, 0] * vector[0] + matrix[1, 1] * vector[1] + matrix[1, 2] * vector[2],
        matrix[2, 0] * vector[0] + matrix[2, 1] * vector[1] + matrix[2, 2] * vector[2],
    )


@compiled
def without_negative_part(matrix):  # type: ignore[no-untyped-def]
    """Return a symmetric matrix (3, 3) whose negative eigenvalues are replaced by zero, by Jacobi's method."""
    rotated, vectors, result, largest = matrix.copy(), np.zeros((3, 3)), np.zeros((3, 3)), 0.0
    for i in range(3):
        vectors[i, i] = 1.0
        for j in range(3):
            largest = max(largest, abs(matrix[i, j]))
    negligible = NEGLIGIBLE * largest
    for _ in range(MAX_SWEEPS):
        if abs(rotated[0, 1]) <= negligible and abs(rotated[0, 2]) <= negligible and abs(rotated[1, 2]) <= negligible:
            break
        for p, q in ((0, 1), (0, 2), (1, 2)):
            if rotated[p, q] != 0.0:
                half = 0.5 * (rotated[q, q] - rotated[p, p]) / rotated[p, q]
                tangent = math.copysign(1.0, half) / (abs(half) + math.hypot(half, 1.0))
                c = 1.0 / math.hypot(tangent, 1.0)
                s = tangent * c
                _rotate_columns(vectors, p, q, c, s)
                _rotate_columns(rotated, p, q, c, s)
                _rotate_columns(rotated.T, p, q, c, s)
    for k in range(3):
        if rotated[k, k] > 0.0:
            for i in range(3):
                for j in range(3):
                    result[i, j] += rotated[k, k] * vectors[i, k] * vectors[j, k]
    return result


@inlined
def _rotate_columns(matrix, p, q, c, s):  # type: ignore[no-untyped-def]
    """Rotate two columns of a matrix (3, 3) by the angle with cosine c and sine s."""
    for k in range(3):
        at_p, at_q = matrix[k, p], matrix[k, q]
        matrix[k, p], matrix[k, q] = c * at_p - s * at_q, s * at_p + c * at_q


@inlined
def mahalanobis_squared(xx, xy, yy, x, y):  # type: ignore[no-untyped-def]
    """Return v' M^-1 v with the vector v = (x, y) and the matrix (2, 2) of the elements xx, xy and yy."""
    return (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)


@inlined
def bilinear_form(matrix, ux, uy, uz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """Return u' M v with the vectors u and v, and a symmetric matrix M (3, 3)."""
    first = ux * (matrix[0, 0] * vx + matrix[0, 1] * vy + matrix[0, 2] * vz)
    second = uy * (matrix[0, 1] * vx + matrix[1, 1] * vy + matrix[1, 2] * vz)
    return first + second + uz * (matrix[0, 2] * vx + matrix[1, 2] * vy + matrix[2, 2] * vz)


@inlined
def quadratic_form(matrix, x, y, z):  # type: ignore[no-untyped-def]
    """Return v' M v with the vector v = (x, y, z)."""
    squares = matrix[0, 0] * x * x + matrix[1, 1] * y * y + matrix[2, 2] * z * z
    return squares + 2.0 * (matrix[0, 1] * x * y + matrix[0, 2] * x * z + matrix[1, 2] * y * z)

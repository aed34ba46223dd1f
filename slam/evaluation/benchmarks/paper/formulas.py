"""Implement the paper's three methods in its notation and in plain NumPy, with weights w = 1 / rho^k.

The estimators of `features` are the same mathematics in other variables, compiled. These versions cover what the
project itself does not need: the double sums that the paper times, other weights, and variants that the paper may have
used. `power` is k: 2 gives the weights of eq. (17), 0 equal ones. All Jacobians are exact, including the dependence of
the weights on the measured ranges.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from features import Noise

from ....geometry.segments import Floats


class Line(NamedTuple):
    """Parameters (k,) of a line and their covariance (k, k)."""

    parameters: Floats
    covariance: Floats


Fit = Callable[[Floats, Floats, Noise], Line]
Corner = Callable[[Line, Line], tuple[Floats, Floats]]


def wclm(ranges: Floats, angles: Floats, noise: Noise) -> Line:
    """Fit (x_Q, y_Q) by eqs. (18)-(19) with the covariance (22)-(25).

    The prefactor of eq. (23) and M = mean(x^2) mean(y^2) - mean(x y)^2 are interpreted such that the derivatives are
    exact.
    """
    x, y = ranges * np.cos(angles), ranges * np.sin(angles)
    w = ranges**-2.0
    w = w / w.sum()
    mx, my, mxx, myy, mxy = w @ x, w @ y, w @ x**2, w @ y**2, w @ (x * y)
    m = mxx * myy - mxy**2
    xq, yq = (mx * myy - my * mxy) / m, (mx * mxy - my * mxx) / m
    r = 1.0 - 2.0 * (x * xq - y * yq)
    a, b = x * myy - y * mxy, y * mxx - x * mxy
    c, d = r * (y * myy + x * mxy) + ranges**2 * my, r * (x * mxx + y * mxy) + ranges**2 * mx
    by_range = w / (m * ranges) * np.stack([-a, b])
    by_bearing = -w / m * np.stack([c, d])
    return Line(np.array([xq, yq]), _propagate(by_range, by_bearing, noise))


def wclm_corner(first: Line, second: Line) -> tuple[Floats, Floats]:
    """Return position (2,) and covariance (2, 2) of the corner by eqs. (36)-(38)."""
    (x1, y1), (x2, y2) = first.parameters, second.parameters
    determinant = x1 * y2 - y1 * x2
    position = np.array([y2 - y1, x2 - x1]) / determinant
    px, py = position
    j1 = -np.array([[y2], [x2]]) * np.array([px, -py]) / determinant
    j2 = np.array([[y1], [x1]]) * np.array([px, -py]) / determinant
    return position, j1 @ first.covariance @ j1.T + j2 @ second.covariance @ j2.T


def double_sums(p: Floats, angles: Floats) -> tuple[float, float, Floats, Floats]:
    """Return the double sums of eq. (27) and the inner sums of their derivatives.

    The sums are 2 p_i p_j sin(theta_i) cos(theta_j) and p_i p_j cos(theta_i + theta_j) over i and j; the inner sums
    are p_j sin(theta_i + theta_j) and p_j cos(theta_i + theta_j) over j.
    """
    sines = np.sin(angles[:, None] + angles)
    cosines = np.cos(angles[:, None] + angles)
    products = p[:, None] * p
    numerator = float(2.0 * np.sum(products * np.sin(angles)[:, None] * np.cos(angles)))
    return numerator, float(np.sum(products * cosines)), np.sum(p * sines, axis=1), np.sum(p * cosines, axis=1)


def single_sums(p: Floats, angles: Floats) -> tuple[float, float, Floats, Floats]:
    """Return the same four values as products of single sums, in O(n)."""
    c, s = np.cos(angles), np.sin(angles)
    x, y = float(p @ c), float(p @ s)
    return 2.0 * x * y, x * x - y * y, s * x + c * y, c * x - s * y


def arras_siegwart(
    ranges: Floats, angles: Floats, noise: Noise, *, power: int = 2, sums: Literal["double", "single"] = "single"
) -> Line:
    """Fit (r, alpha) by eqs. (26)-(28) with the covariance (29)-(30), with the printed double sums or factorised."""
    w, dw = ranges**-power, -power * ranges ** -(power + 1.0)
    p, dp = ranges ** (1.0 - power), (1.0 - power) * ranges**-power
    q, dq = ranges ** (2.0 - power), (2.0 - power) * ranges ** (1.0 - power)
    total = w.sum()
    twice, both, inner_sine, inner_cosine = (double_sums if sums == "double" else single_sums)(p, angles)
    sine, cosine = np.sin(2.0 * angles), np.cos(2.0 * angles)
    n, d = twice / total - q @ sine, both / total - q @ cosine
    alpha = 0.5 * np.arctan2(n, d)
    ahead, aside = np.cos(angles - alpha), np.sin(angles - alpha)
    r = p @ ahead / total
    if r < 0.0:
        r, alpha, ahead, aside = -r, alpha + np.pi, -ahead, -aside
    n_range = (2.0 * dp * inner_sine - twice * dw / total) / total - dq * sine
    d_range = (2.0 * dp * inner_cosine - both * dw / total) / total - dq * cosine
    n_bearing = 2.0 * (p * inner_cosine / total - q * cosine)
    d_bearing = -2.0 * (p * inner_sine / total - q * sine)
    size = n * n + d * d
    alpha_range, alpha_bearing = (d * n_range - n * d_range) / (2 * size), (d * n_bearing - n * d_bearing) / (2 * size)
    k = p @ aside / total
    r_range = (dp * ahead - r * dw) / total + k * alpha_range
    r_bearing = -p * aside / total + k * alpha_bearing
    by_range, by_bearing = np.stack([r_range, alpha_range]), np.stack([r_bearing, alpha_bearing])
    return Line(np.array([r, alpha]), _propagate(by_range, by_bearing, noise))


def arras_siegwart_corner(first: Line, second: Line) -> tuple[Floats, Floats]:
    """Return position (2,) and covariance (2, 2) of the corner by eqs. (39)-(43)."""
    (r1, a1), (r2, a2) = first.parameters, second.parameters
    return _intersect(
        np.array([[np.cos(a1), np.sin(a1)], [np.cos(a2), np.sin(a2)]]),
        np.array([r1, r2]),
        [np.array([[0.0, -np.sin(a)], [0.0, np.cos(a)], [-1.0, 0.0]]) for a in (a1, a2)],
        (first, second),
    )


def siadat(ranges: Floats, angles: Floats, noise: Noise, *, power: int = 2) -> Line:
    """Fit (a, b, c) by eq. (31) under a^2 + b^2 = 1, the smallest eigenvector of the scatter, with covariance (33)."""
    w, dw = ranges**-power, -power * ranges ** -(power + 1.0)
    points = ranges * np.stack([np.cos(angles), np.sin(angles)])
    by_range, by_bearing = points / ranges, np.stack([-points[1], points[0]])
    total = w.sum()
    mean = points @ w / total
    centred = points - mean[:, None]
    values, vectors = np.linalg.eigh((w * centred) @ centred.T)
    normal = vectors[:, 0] if vectors[:, 0] @ mean > 0.0 else -vectors[:, 0]
    along = np.array([-normal[1], normal[0]])
    qn, qt = normal @ centred, along @ centred
    gap = values[1] - values[0]
    columns = []
    for moved, change in ((by_range, dw), (by_bearing, np.zeros_like(dw))):
        dn, dt = normal @ moved, along @ moved
        phi = -(w * (qt * dn + qn * dt) + change * qn * qt) / gap
        c = -(w * dn + change * qn) / total - (along @ mean) * phi
        columns.append(np.stack([along[0] * phi, along[1] * phi, c]))
    return Line(np.array([*normal, -normal @ mean]), _propagate(columns[0], columns[1], noise))


def siadat_corner(first: Line, second: Line) -> tuple[Floats, Floats]:
    """Return position (2,) and covariance (2, 2) of the corner by eqs. (44)-(48)."""
    normals = np.stack([first.parameters[:2], second.parameters[:2]])
    distances = -np.array([first.parameters[2], second.parameters[2]])
    return _intersect(normals, distances, [np.eye(3), np.eye(3)], (first, second))


def without_correlations(line: Line) -> Line:
    """Return the line with the off-diagonal elements of its covariance set to zero."""
    return Line(line.parameters, np.diag(np.diag(line.covariance)))


def _intersect(
    normals: Floats, distances: Floats, jacobians: list[Floats], lines: tuple[Line, Line]
) -> tuple[Floats, Floats]:
    """Return the corner of two lines n . p = d; `jacobians` are those of (n, -d) by the lines' parameters."""
    inverse = np.linalg.inv(normals)
    position = inverse @ distances
    covariance = np.zeros((2, 2))
    for column, jacobian, line in zip(inverse.T, jacobians, lines, strict=True):
        gradient = np.array([*position, 1.0]) @ jacobian
        covariance += (gradient @ line.covariance @ gradient) * np.outer(column, column)
    return position, covariance


def _propagate(by_range: Floats, by_bearing: Floats, noise: Noise) -> Floats:
    """Return the covariance (k, k) from the Jacobians (k, n) by ranges and bearings."""
    spread = noise.sigma_range**2 * (by_range @ by_range.T) + noise.sigma_bearing**2 * (by_bearing @ by_bearing.T)
    return np.asarray(spread)

"""Corners in three parametrisations of a line, and conversions between these."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from features import ESTIMATORS, LineFit, Noise, arras_siegwart, conversions, corner, siadat, wclm
from features.conversions import covariance_through

NOISE = Noise(0.05, np.radians(0.1955))


def rays_on(distance: float, normal: float, low: float, high: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    angles = np.linspace(low, high, count)
    return distance / np.cos(angles - normal) + 0.02 * np.sin(37 * np.arange(count)), angles


def two_lines(name: str) -> tuple[LineFit, LineFit]:
    fit = ESTIMATORS[name].fit
    return (
        fit(*rays_on(1.7, 0.7, 0.2, 1.3, 12), NOISE),
        fit(*rays_on(1.2, 2.2707963267948967, 1.6, 2.9, 15), NOISE),
    )


def jacobian_of(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, step: float = 1e-6) -> np.ndarray:
    columns = [(function(at + step * e) - function(at - step * e)) / (2 * step) for e in np.eye(len(at))]
    return np.array(columns).T


def test_golden_corner() -> None:
    position, covariance = corner.corner(*two_lines("wclm"))
    np.testing.assert_allclose(position, [0.5319543203063514, 2.012937247798769], rtol=1e-12)
    golden = [[0.0009951695953029688, -0.00036476689910305577], [-0.00036476689910305577, 0.0011339460528687634]]
    np.testing.assert_allclose(covariance, golden, rtol=1e-9)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_corners_agree_in_all_parametrisations(name: str) -> None:
    first, second = two_lines(name)
    position, covariance = ESTIMATORS[name].corner(first, second)
    expected_position, expected_covariance = corner.corner(first, second)
    np.testing.assert_allclose(position, expected_position, rtol=1e-9)
    np.testing.assert_allclose(covariance, expected_covariance, rtol=1e-8)


@pytest.mark.parametrize("module", [corner, arras_siegwart, siadat])
def test_corner_covariance_equals_that_of_numeric_jacobian(module: object) -> None:
    name = {corner: "wclm", arras_siegwart: "arras-siegwart", siadat: "siadat"}[module]
    first, second = two_lines(name)
    size = len(first.parameters)

    def position(parameters: np.ndarray) -> np.ndarray:
        # the parameters of "wclm" are (x_Q, y_Q) = (u, -v)
        lines = [
            LineFit(p * [1, -1] if name == "wclm" else first.uv, fit.covariance, p, fit.parameter_covariance)
            for p, fit in ((parameters[:size], first), (parameters[size:], second))
        ]
        return module.corner(*lines)[0]

    jacobian = jacobian_of(position, np.concatenate([first.parameters, second.parameters]))
    joint = np.zeros((2 * size, 2 * size))
    joint[:size, :size], joint[size:, size:] = first.parameter_covariance, second.parameter_covariance
    np.testing.assert_allclose(module.corner(first, second)[1], covariance_through(jacobian, joint), rtol=1e-6)


def test_corner_covariance_is_consistent() -> None:
    rng, trials, total = np.random.default_rng(3), 1500, 0.0
    noise = Noise(0.01, np.radians(0.1))
    walls = [(1.7, 0.7, np.linspace(0.2, 1.3, 60)), (1.2, 2.27, np.linspace(1.6, 2.9, 70))]
    exact = [LineFit(np.array([np.cos(a), np.sin(a)]) / d, *[np.zeros((2, 2))] * 3) for d, a, _ in walls]
    truth = corner.corner(*exact)[0]
    for _ in range(trials):
        lines = []
        for distance, normal, angles in walls:
            bearings = angles + rng.normal(0, noise.sigma_bearing, len(angles))
            ranges = distance / np.cos(bearings - normal) + rng.normal(0, noise.sigma_range, len(angles))
            lines.append(wclm.fit_maximum_likelihood(ranges, angles, noise))
        position, covariance = corner.corner(*lines)
        total += (position - truth) @ np.linalg.solve(covariance, position - truth)
    assert 1.8 < total / trials < 2.2


def test_parallel_lines_have_no_corner() -> None:
    line = two_lines("wclm")[0]
    assert np.isnan(corner.corner(line, line)[0]).all()
    assert corner.parallel(1.0, 0.0, 2.0, 0.1)
    assert not corner.parallel(1.0, 0.0, 0.0, 2.0)


UV = np.array([0.31, -0.44])


@pytest.mark.parametrize(
    ("conversion", "at"),
    [
        (conversions.polar_of_uv, UV),
        (conversions.uv_of_polar, np.array([1.4, 2.5])),
        (conversions.uv_of_implicit, np.array([0.6, 0.8, -2.0])),
    ],
)
def test_conversion_jacobians(conversion: Callable[..., tuple[np.ndarray, np.ndarray]], at: np.ndarray) -> None:
    numeric = jacobian_of(lambda x: conversion(x)[0], at)
    np.testing.assert_allclose(conversion(at)[1], numeric, atol=1e-7)


def test_conversions_are_inverse() -> None:
    polar, _ = conversions.polar_of_uv(UV)
    np.testing.assert_allclose(conversions.uv_of_polar(polar)[0], UV)
    assert 1.0 / np.hypot(*UV) == pytest.approx(polar[0])

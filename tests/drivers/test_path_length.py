"""The length of a path is what was driven, not the jitter of a position that stands."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.path_length import path_length


def test_steps_are_summed() -> None:
    assert path_length(np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])) == pytest.approx(6.0)
    assert path_length(np.array([[0.01 * k, 0.0] for k in range(1000)])) == pytest.approx(9.99)
    assert path_length(np.zeros((1, 2))) == 0.0
    assert path_length(np.zeros((0, 2))) == 0.0


def test_jitter_is_not_driving() -> None:
    jitter = 0.005 * np.random.default_rng(1).standard_normal((5000, 2))
    assert path_length(jitter) < 0.05
    driven = np.linspace([0.0, 0.0], [20.0, 0.0], 5000) + jitter
    assert path_length(driven) == pytest.approx(20.0, rel=0.03)


def test_curves_are_hardly_shortened() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 2000)
    circle = 0.3 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert path_length(circle) == pytest.approx(2.0 * np.pi * 0.3, rel=0.005)

"""Dead reckoning along arcs compared with closed forms, numerical integration and simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from drivers import se2
from drivers.bases.kinematics import ArcMotion, OdometryNoise, advance, motion_from_gyro, motion_from_wheels

NOISE = OdometryNoise()
EXACT = OdometryNoise(wheel=0.0, gyro=0.0)
ZERO = np.zeros((3, 3))
distances = st.floats(-2.0, 2.0)
turns = st.one_of(st.floats(-3.0, 3.0), st.floats(-1e-3, 1e-3), st.just(0.0))
poses = st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(-3.1, 3.1)).map(np.array)


def motion(distance: float, turn: float) -> ArcMotion:
    return ArcMotion(distance, turn, np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("pose", "left", "right", "expected"),
    [
        ((0, 0, 0), 0.1, 0.12, (0.109867258, 0.004678026, 0.085106383)),
        ((0, 0, 0), -0.1, 0.1, (0, 0, 0.851063830)),
        ((1, 2, math.pi / 2), 0.5, 0.5, (1, 2.5, math.pi / 2)),
    ],
)
def test_known_arcs_are_reproduced(
    pose: tuple[float, ...], left: float, right: float, expected: tuple[float, ...]
) -> None:
    new, _ = advance(np.array(pose, dtype=float), ZERO, motion_from_wheels(left, right, 0.235, EXACT))
    assert_allclose(new, expected, atol=1e-9)


def test_known_covariance_of_a_straight_metre() -> None:
    pose, covariance = np.zeros(3), ZERO
    for _ in range(100):
        pose, covariance = advance(pose, covariance, motion_from_wheels(0.01, 0.01, 0.235, OdometryNoise(wheel=1e-5)))
    assert_allclose(np.sqrt(np.diag(covariance)), [2.236e-3, 10.99e-3, 0.01903], rtol=1e-3)


@settings(max_examples=40, deadline=None)
@given(pose=poses, distance=distances, turn=turns)
def test_an_arc_equals_its_numerical_integral(pose: se2.Pose, distance: float, turn: float) -> None:
    new, _ = advance(pose, ZERO, motion(distance, turn))
    heading = pose[2] + turn * np.linspace(0, 1, 4001)
    x, y = (np.trapezoid(distance * f(heading), dx=1 / 4000) for f in (np.cos, np.sin))
    assert_allclose(new[:2], pose[:2] + np.array([x, y]), atol=1e-6)
    assert abs(math.remainder(new[2] - pose[2] - turn, 2 * math.pi)) < 1e-12
    assert -math.pi <= new[2] < math.pi


@settings(max_examples=40, deadline=None)
@given(pose=poses, distance=distances, turn=turns, steps=st.integers(2, 40))
def test_an_arc_equals_the_sum_of_its_parts(pose: se2.Pose, distance: float, turn: float, steps: int) -> None:
    whole, _ = advance(pose, ZERO, motion(distance, turn))
    parts = pose
    for _ in range(steps):
        parts, _ = advance(parts, ZERO, motion(distance / steps, turn / steps))
    assert_allclose(parts[:2], whole[:2], atol=1e-11)
    assert abs(math.remainder(parts[2] - whole[2], 2 * math.pi)) < 1e-11


@settings(max_examples=40, deadline=None)
@given(pose=poses, distance=distances, turn=turns)
def test_the_reverse_arc_returns_to_the_start(pose: se2.Pose, distance: float, turn: float) -> None:
    there, _ = advance(pose, ZERO, motion(distance, turn))
    back, _ = advance(there, ZERO, motion(-distance, -turn))
    assert_allclose(back[:2], pose[:2], atol=1e-12)
    assert_allclose(se2.between(pose, there)[:2], advance(np.zeros(3), ZERO, motion(distance, turn))[0][:2], atol=1e-11)


@settings(max_examples=40, deadline=None)
@given(pose=poses, distance=distances, turn=turns)
def test_covariance_is_propagated_by_the_jacobians(pose: se2.Pose, distance: float, turn: float) -> None:
    step = 1e-6
    numeric = np.zeros((3, 5))
    for column in range(5):
        ends = []
        for sign in (-1, 1):
            at = np.array([*pose, distance, turn])
            at[column] += sign * step
            end, _ = advance(at[:3], ZERO, motion(at[3], at[4]))
            ends.append(end)
        difference = ends[1] - ends[0]
        difference[2] = math.remainder(difference[2], 2 * math.pi)
        numeric[:, column] = difference / (2 * step)
    prior, noise = np.diag([1e-3, 2e-3, 3e-3]), np.array([[4e-4, 1e-4], [1e-4, 5e-4]])
    _, covariance = advance(pose, prior, ArcMotion(distance, turn, noise))
    expected = numeric[:, :3] @ prior @ numeric[:, :3].T + numeric[:, 3:] @ noise @ numeric[:, 3:].T
    assert_allclose(covariance, expected, atol=1e-8)


@pytest.mark.parametrize("gyro", [False, True])
def test_covariance_equals_the_scatter_of_simulated_drives(gyro: bool) -> None:
    random = np.random.default_rng(5)
    track, steps, drives, noise = 0.235, 100, 4000, OdometryNoise(wheel=1e-5, gyro=1e-5)
    left, right = 0.010 + 0.002 * np.sin(np.arange(steps) / 9), 0.012 - 0.003 * np.cos(np.arange(steps) / 17)
    pose, covariance = np.zeros(3), ZERO
    ends = np.zeros((drives, 3))
    for dl, dr in zip(left, right, strict=True):
        turn = (dr - dl) / track
        true = motion_from_gyro(dl, dr, turn, 0.02, noise) if gyro else motion_from_wheels(dl, dr, track, noise)
        pose, covariance = advance(pose, covariance, true)
        noisy_left = dl + np.sqrt(noise.wheel * dl) * random.standard_normal(drives)
        noisy_right = dr + np.sqrt(noise.wheel * dr) * random.standard_normal(drives)
        noisy_turn = (noisy_right - noisy_left) / track
        if gyro:
            noisy_turn = turn + np.sqrt(noise.gyro * 0.02) * random.standard_normal(drives)
        middle = ends[:, 2] + noisy_turn / 2
        chord = (noisy_left + noisy_right) / 2 * np.sinc(noisy_turn / (2 * np.pi))
        ends += np.column_stack([chord * np.cos(middle), chord * np.sin(middle), noisy_turn])
    assert_allclose(ends.mean(axis=0)[:2], pose[:2], atol=2e-3)
    sigma = np.sqrt(np.diag(covariance))
    scatter = np.cov(ends.T)
    assert_allclose(scatter / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=0.08)
